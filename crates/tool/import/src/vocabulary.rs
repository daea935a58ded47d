//! The words that headers and cells use, in German, English, French, Spanish and Italian.

/// A time.
pub(crate) const TIME_KEYWORDS: &str = "dauer laufzeit duration sekunden seconds sec minuten minutes stunden hours zeit time temps tiempo tempo timestamp zeitstempel datetime uhrzeit clock elapsed epoch unix \
    unixtime t messzeit zeitpunkt heure hora ora";
/// A date.
pub(crate) const DATE_KEYWORDS: &str = "datum date fecha data tag day";
/// A commanded position.
pub(crate) const COMMANDED_POSITION_KEYWORDS: &str = "position pos soll sollposition sollwert sollpos target targets nominal weg stellung commanded \
    command setpoint posicion posizione lage ziel zielposition cible consigne objetivo";
/// An actual position.
pub(crate) const ACTUAL_POSITION_KEYWORDS: &str =
    "ist istposition istwert istpos actual reel real reale effettiva";
/// A reading of a gauge.
pub(crate) const MEASURED_VALUE_KEYWORDS: &str = "abw abweichungen delta messuhr messwert messung gauge dial indicator reading anzeige abweichung deviation dev error \
    fehler ablesung ecart erreur comparateur lecture desviacion lectura errore lettura scostamento \
    comparatore comparador dti measured measurement fuehluhr taster feintaster laser elongation \
    laengung dehnung wachstum growth verlagerung displacement dilatation allongement \
    positionsabweichung difference differenz diff";
/// The growth of a spindle.
pub(crate) const ELONGATION_KEYWORDS: &str = "elongation laengung dehnung wachstum growth dilatation allongement spindellaengung \
    spindelwachstum spindeldehnung";
/// A direction of approach.
pub(crate) const DIRECTION_KEYWORDS: &str =
    "richtung direction dir anfahrrichtung sens direccion direzione approach";
/// The number of a repeat.
pub(crate) const RUN_KEYWORDS: &str = "run lauf zyklus cycle wiederholung repeat wdh messreihe durchgang durchlauf serie passage ciclo \
    repetition reihe pass";
/// A speed of the spindle.
pub(crate) const SPEED_KEYWORDS: &str = "spindel spindle broche husillo mandrino drehzahl rpm speed spindeldrehzahl vitesse velocidad giri regime n";
/// A feed.
pub(crate) const FEED_KEYWORDS: &str = "f vorschub feed feedrate avance avanzamento";
/// A force.
pub(crate) const LOAD_KEYWORDS: &str =
    "f fz fa axial kraft force last load forza fuerza axialkraft schnittkraft effort";
/// A temperature.
pub(crate) const TEMPERATURE_KEYWORDS: &str =
    "temperatur temperature temp temperatura tmp fuehler pt100";
/// The displacement sensor.
pub(crate) const SENSOR_KEYWORDS: &str =
    "sensor wegsensor abstandssensor wegaufnehmer capteur sonde probe eddy";
/// A number of something.
pub(crate) const NUMBER_KEYWORDS: &str = "nr no num number nummer";
/// Words with which a number counts the rows.
pub(crate) const ROW_KEYWORDS: &str =
    "mess messpunkt satz datensatz block line record eintrag entry ligne linea riga fila";
/// No quantity of a run.
pub(crate) const IGNORED_KEYWORDS: &str = "lfd index idx bemerkung bemerkungen kommentar comment comments remark \
    remarks note notes notiz pruefer operator remarque row zeile sample punkt point id";
/// Words that add nothing.
pub(crate) const STOP_WORDS: &str = "achse axis axe eje asse der die das of the de des in am an machine maschine wert value spindel \
    spindle broche messuhr gemessen measured";
/// The way there.
const FORWARD_KEYWORDS: &str = "hinfahrt hinweg vorlauf hinlauf vorwaertslauf + +1 1 +x +y +z x+ y+ z+ hin vor vorwaerts auf forward fwd pos positiv positive up aller ida \
    andata ↑ → > +1.0 1.0 f steigend rechts";
/// The way back.
const REVERSE_KEYWORDS: &str = "rueckfahrt rueckweg ruecklauf rueckwaertslauf - -1 -x -y -z x- y- z- her rueck zurueck rueckwaerts ab reverse rev backward back bwd neg \
    negativ negative down retour vuelta ritorno ↓ ← < -1.0 r fallend links";

/// Returns true if `list` has the word.
pub(crate) fn contains_word(list: &str, word: &str) -> bool {
    list.split_whitespace().any(|other| other == word)
}

/// Returns the direction that a word of a table says.
pub(crate) fn parse_direction(text: &str) -> Option<f64> {
    let text = text.trim().to_lowercase().replace('\u{2212}', "-");
    let text = text.replace('ü', "ue").replace('ä', "ae");
    match (contains_word(FORWARD_KEYWORDS, &text), contains_word(REVERSE_KEYWORDS, &text)) {
        (true, _) => Some(1.0),
        (_, true) => Some(-1.0),
        _ => None,
    }
}

/// Returns 1 or 0 for a word of a switch.
pub(crate) fn parse_on_off(text: &str) -> Option<f64> {
    match text.trim().to_lowercase().as_str() {
        "on" | "true" | "ein" | "an" | "ja" | "yes" | "wahr" | "marche" | "si" | "oui" => Some(1.0),
        "off" | "false" | "aus" | "nein" | "no" | "falsch" | "arrêt" | "non" => Some(0.0),
        _ => None,
    }
}

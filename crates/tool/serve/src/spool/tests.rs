use super::*;

const LIMIT: u64 = 64 << 20;

fn draft(text: &str) -> NewRecord {
    let text = text.to_owned();
    let payload = move |id: &str| format!("{id} {text}").into_bytes();
    NewRecord { time_ms: 1_000, topic: "t".into(), payload: Box::new(payload) }
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a folder")
}

fn open(folder: &tempfile::TempDir) -> Spool {
    Spool::open(folder.path(), LIMIT).expect("it opens")
}

fn fill(spool: &mut Spool, numbers: std::ops::Range<u32>) {
    for number in numbers {
        spool.append(&[draft(&number.to_string())]).expect("there is room");
    }
}

/// Returns the texts of all that is to be sent.
fn texts(spool: &mut Spool) -> Vec<String> {
    let payloads = std::iter::from_fn(|| spool.next_unsent_record(Instant::now()))
        .map(|message| message.payload);
    payloads.map(|payload| String::from_utf8(payload).expect("text")).collect()
}

fn numbers_of(texts: &[String]) -> Vec<u32> {
    let number = |text: &String| text.split_once(' ')?.1.parse().ok();
    texts.iter().filter_map(number).collect()
}

fn files(folder: &tempfile::TempDir) -> Vec<PathBuf> {
    let all = fs::read_dir(folder.path()).expect("a folder").flatten().map(|entry| entry.path());
    let mut all: Vec<_> = all
        .filter(|path| path.extension().is_some_and(|extension| extension == SEGMENT_EXTENSION))
        .collect();
    all.sort();
    all
}

#[test]
fn what_was_not_settled_comes_again_with_the_same_identifier_after_a_restart() {
    let folder = folder();
    let mut spool = open(&folder);
    fill(&mut spool, 0..10);
    let first = texts(&mut spool);
    assert_eq!(numbers_of(&first), (0..10).collect::<Vec<_>>());
    for number in 1..=6 {
        spool.acknowledge(number, Instant::now());
    }
    assert_eq!(spool.unacknowledged_count(), 4);
    spool.rewind();
    assert_eq!(texts(&mut spool), first, "the broker may have died with what it acknowledged");
    for number in 1..=6 {
        spool.acknowledge(number, Instant::now());
    }
    spool.settle(Instant::now() + RETENTION_TIME);
    drop(spool);
    let mut spool = open(&folder);
    assert_eq!(texts(&mut spool), first[6..]);
    fill(&mut spool, 10..12);
    assert_eq!(numbers_of(&texts(&mut spool)), [10, 11]);
    assert_eq!(files(&folder).len(), 2, "a file is never written again");
}

#[test]
fn acknowledgements_in_another_order_settle_nothing_that_is_open() {
    let folder = folder();
    let mut spool = open(&folder);
    fill(&mut spool, 0..4);
    texts(&mut spool);
    for number in [4, 3, 1] {
        spool.acknowledge(number, Instant::now());
    }
    spool.settle(Instant::now() + RETENTION_TIME);
    assert_eq!((spool.settled, spool.unacknowledged_count()), (1, 1));
    spool.acknowledge(2, Instant::now());
    spool.settle(Instant::now() + RETENTION_TIME);
    assert_eq!((spool.settled, spool.unacknowledged_count()), (4, 0));
    // The numbers go on, though every file of before is gone.
    drop(spool);
    let mut spool = open(&folder);
    assert_eq!(files(&folder), [""; 0].map(PathBuf::from));
    fill(&mut spool, 4..5);
    assert_eq!(spool.next_unsent_record(Instant::now()).expect("the new one").number, 5);
}

#[test]
fn a_damaged_number_of_what_is_settled_costs_no_record() {
    let folder = folder();
    let mut spool = open(&folder);
    fill(&mut spool, 0..3);
    texts(&mut spool);
    spool.acknowledge(1, Instant::now());
    spool.settle(Instant::now() + RETENTION_TIME);
    drop(spool);
    let path = folder.path().join(SETTLED_FILE_NAME);
    let text = fs::read_to_string(&path).expect("the file");
    assert_eq!(numbers_of(&texts(&mut open(&folder))), [1, 2]);
    fs::write(&path, text.replacen('1', "9", 1)).expect("the file");
    assert_eq!(numbers_of(&texts(&mut open(&folder))), [0, 1, 2]);
}

#[test]
fn a_flipped_bit_is_reported_with_number_and_time_and_all_others_are_sent() {
    let folder = folder();
    let mut spool = open(&folder);
    fill(&mut spool, 0..5);
    let at = spool.segments[0].entries[2].at as usize;
    drop(spool);
    let path = files(&folder).remove(0);
    let mut bytes = fs::read(&path).expect("the file");
    bytes[at + 30] ^= 4;
    fs::write(&path, bytes).expect("the file");
    let mut spool = open(&folder);
    let reports = spool.take_reports();
    assert_eq!(reports.len(), 1);
    let text = reports[0].to_string();
    let phrase = "number 3, after 1970-01-01T00:00:01.000Z, before 1970-01-01T00:00:01.000Z";
    assert!(text.contains(phrase) && text.contains("damaged"), "{text}");
    assert_eq!(numbers_of(&texts(&mut spool)), [0, 1, 3, 4]);
    assert_eq!(fs::read_dir(folder.path().join("damaged")).expect("a folder").count(), 1);
    // It is reported once.
    drop(spool);
    assert_eq!(open(&folder).take_reports(), []);
}

#[test]
fn a_file_that_was_cut_loses_its_end_alone_and_its_number_is_not_given_again() {
    let folder = folder();
    let mut spool = open(&folder);
    fill(&mut spool, 0..5);
    let end = spool.segments[0].entries[4].at + 10;
    drop(spool);
    let path = files(&folder).remove(0);
    let file = OpenOptions::new().write(true).open(&path).expect("the file");
    file.set_len(end).expect("cut");
    let mut spool = open(&folder);
    let text = spool.take_reports()[0].to_string();
    assert!(text.contains("number 5, where the file ends"), "{text}");
    let before = texts(&mut spool);
    assert_eq!(numbers_of(&before), [0, 1, 2, 3]);
    fill(&mut spool, 7..8);
    let new = texts(&mut spool);
    assert_eq!(numbers_of(&new), [7]);
    let id = |text: &str| text.split_once('-').map(|(id, _)| id.to_owned());
    assert_ne!(id(&new[0]), id(&before[0]), "whatever its number, its identifier is new");
}

#[test]
fn a_bit_that_flips_while_the_spool_is_open_costs_one_record() {
    let folder = folder();
    let mut spool = open(&folder);
    fill(&mut spool, 0..3);
    let at = spool.segments[0].entries[1].at as usize;
    let path = files(&folder).remove(0);
    let mut bytes = fs::read(&path).expect("the file");
    bytes[at + 9] ^= 1;
    fs::write(&path, bytes).expect("the file");
    assert_eq!(numbers_of(&texts(&mut spool)), [0, 2]);
    assert!(spool.take_reports()[0].to_string().contains("record 2 of 1970-01-01"));
}

/// A folder in the place of the file is an error of the system for every user, root among them.
#[cfg(unix)]
#[test]
fn a_file_that_cannot_be_read_for_a_moment_costs_no_record() {
    let folder = folder();
    let mut spool = open(&folder);
    fill(&mut spool, 0..3);
    let path = files(&folder).remove(0);
    let aside = folder.path().join("aside");
    let hide = || {
        fs::rename(&path, &aside).expect("it is there");
        fs::create_dir(&path).expect("its name is free");
    };
    let show = || {
        fs::remove_dir(&path).expect("it is there");
        fs::rename(&aside, &path).expect("its name is free");
    };
    let now = Instant::now();
    hide();
    assert_eq!(spool.next_unsent_record(now), None);
    assert_eq!(spool.next_unsent_record(now + READ_RETRY_TIMEOUT / 2), None);
    let reports = spool.take_reports();
    assert_eq!((reports.len(), reports[0].lost_record_count()), (1, 0), "{reports:?}");
    assert!(reports[0].to_string().contains("it is tried again"), "{}", reports[0]);
    show();
    assert_eq!(numbers_of(&texts(&mut spool)), [0, 1, 2]);
    // One that stays so is given up, and what is written then is sent.
    spool.rewind();
    hide();
    assert_eq!(spool.next_unsent_record(now), None);
    assert_eq!(spool.next_unsent_record(now + READ_RETRY_TIMEOUT), None);
    let lost: u64 = spool.take_reports().iter().map(SpoolReport::lost_record_count).sum();
    assert_eq!((lost, spool.unacknowledged_count()), (3, 0));
    show();
    // Its bytes stay for people.
    fill(&mut spool, 3..4);
    assert_eq!(numbers_of(&texts(&mut spool)), [3]);
    drop(spool.active.take());
    spool.acknowledge(4, now);
    spool.settle(now + READ_RETRY_TIMEOUT + RETENTION_TIME);
    assert!(files(&folder).is_empty());
    let stored =
        fs::read(folder.path().join(DAMAGED_FOLDER_NAME).join(path.file_name().expect("a name")));
    assert!(stored.is_ok_and(|bytes| !bytes.is_empty()));
}

#[test]
fn the_oldest_files_give_way_and_the_report_says_which_records() {
    let folder = folder();
    let mut spool = Spool::open(folder.path(), 3 * SEGMENT_ROLLOVER_BYTES).expect("it opens");
    let long = "x".repeat(1_000);
    let drafts: Vec<NewRecord> = (0..500).map(|_| draft(&long)).collect();
    for _ in 0..12 {
        spool.append(&drafts).expect("there is room");
    }
    let reports = spool.take_reports();
    assert!(!reports.is_empty());
    let SpoolReport::Overrun { count, numbers: [first, last], .. } = &reports[0] else {
        panic!("{reports:?}")
    };
    assert_eq!((*first, *count as u64), (1, *last));
    assert!(reports[0].to_string().contains("--spool-mb"), "{}", reports[0]);
    let gone: usize = reports
        .iter()
        .map(|report| match report {
            SpoolReport::Overrun { count, .. } => *count,
            other => panic!("{other:?}"),
        })
        .sum();
    assert_eq!(gone + texts(&mut spool).len(), 12 * 500);
    let bytes: u64 =
        files(&folder).iter().map(|file| fs::metadata(file).expect("it is there").len()).sum();
    assert!(bytes <= 3 * SEGMENT_ROLLOVER_BYTES, "{bytes}");
}

#[test]
fn a_second_publisher_of_one_folder_is_refused() {
    let folder = folder();
    let first = open(&folder);
    let error = Spool::open(folder.path(), LIMIT).err().expect("it is locked");
    assert!(
        format!("{error:#}").contains("another process publishes from this spool"),
        "{error:#}"
    );
    drop(first);
    open(&folder);
}

/// A file system with no room: what cannot be written is an error, is not read later, and the next one is recorded.
#[cfg(target_os = "linux")]
#[test]
fn what_a_full_disk_takes_not_is_an_error_and_the_rest_goes_on() {
    let folder = folder();
    let mut spool = open(&folder);
    fill(&mut spool, 0..2);
    let full = OpenOptions::new().write(true).open("/dev/full").expect("Linux has it");
    let whole = spool.active.replace(full);
    assert!(spool.append(&[draft("2")]).is_err());
    drop(whole);
    fill(&mut spool, 3..4);
    assert_eq!(numbers_of(&texts(&mut spool)), [0, 1, 3]);
    drop(spool);
    let mut spool = open(&folder);
    assert_eq!((numbers_of(&texts(&mut spool)), spool.take_reports()), (vec![0, 1, 3], Vec::new()));
}

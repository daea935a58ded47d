//! The errors of the axes, kept from message to message and added up when they are asked for.

use super::{Bridge, state::State};
use crate::{
    cnc::LinearAxis,
    geometry::{CachedErrors, ErrorSums},
    heat::Heat,
    place::Place,
};

impl Bridge<'_> {
    /// Returns the errors of the axes at the present place.
    #[inline]
    pub(super) fn axis_errors(&self, state: &mut State) -> ErrorSums {
        match &state.axes {
            Some((_, Some(sums))) => *sums,
            _ => self.add_up_errors(state),
        }
    }

    #[inline(never)]
    fn add_up_errors(&self, state: &mut State) -> ErrorSums {
        let place = &state.place;
        let (errors, kept) = state
            .axes
            .get_or_insert_with(|| (CachedErrors::at(&self.calibration, &state.heat, place), None));
        *kept.insert(self.sums(errors, place))
    }

    fn sums(&self, errors: &mut CachedErrors, place: &Place) -> ErrorSums {
        errors.add_up(&self.calibration, place);
        errors.errors().sums(self.largest)
    }

    /// Applies a change in an input of the errors to the cached ones. Before they are first asked for nothing is kept.
    ///
    /// Those of a volume are added up by the tick that asks for them, once however many messages came before it;
    /// without one that is done here, and the tick has none of it.
    #[inline]
    pub(super) fn update(
        &self,
        state: &mut State,
        change: impl FnOnce(&mut CachedErrors, &Heat, &Place),
    ) {
        if let Some((errors, sums)) = &mut state.axes {
            change(errors, &state.heat, &state.place);
            *sums = match &self.calibration.volume {
                None => Some(self.sums(errors, &state.place)),
                Some(_) => None,
            };
        }
    }

    /// An axis has moved or turned round.
    pub(super) fn moved(&self, state: &mut State, axis: LinearAxis) {
        let calibration = &self.calibration;
        self.update(state, |errors, heat, place| errors.moved(calibration, heat, place, axis));
    }

    /// The heat of an axis has been stepped.
    pub(super) fn warmed(&self, state: &mut State, axis: LinearAxis) {
        let calibration = &self.calibration;
        self.update(state, |errors, heat, place| errors.warmed(calibration, heat, place, axis));
    }

    /// A term over temperature or time has been stepped.
    pub(super) fn term_warmed(&self, state: &mut State) {
        let calibration = &self.calibration;
        self.update(state, |errors, heat, place| errors.terms_changed(calibration, heat, place));
    }
}

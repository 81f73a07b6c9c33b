//! Decides whether a file is read by its observations or by its states, depending on which of them its demonstrations have.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use super::demo::OBSERVATIONS;
use super::fault::Hdf5Fault;
use super::file::File;
use super::names::listed;
use super::reader::{DemoChoice, Layout};
use crate::demos::DemoName;
use crate::warning::{Warning, WarningCode};

/// Which observations a demonstration has.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Observed {
    /// All that are required.
    Whole,
    /// A group `obs` without this observation.
    Lacks(&'static str),
    /// No group `obs`.
    None,
}

/// What a look at all requested demonstrations of a file found. It follows from the content of the file and the choice, so a process
/// that has it need not look at the demonstrations again.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Surveyed {
    /// The choice for which it holds.
    pub(super) choice: DemoChoice,
    /// Number of requested demonstrations.
    pub(super) demonstrations: usize,
    /// Number of all demonstrations in the file.
    pub(super) found: usize,
    /// Members of `/data` that are not demonstrations.
    pub(super) others: Vec<String>,
    pub(super) layout: Layout,
    /// Whether the pose of the object must be computed from the states.
    pub(super) object_from_states: bool,
    /// Whether no demonstration has the observation of the object.
    pub(super) lacks_objects: bool,
    /// Names of the observations that at least one demonstration has.
    pub(super) observations: BTreeSet<String>,
    /// Whether observations exist but are not used.
    pub(super) warning: Option<Warning>,
}

/// Which data the demonstrations of a file have.
#[derive(Debug)]
pub(super) struct Survey {
    demos: Vec<(String, Observed)>,
    /// Whether every demonstration has states and a model.
    states: bool,
    /// Names of the observations that at least one demonstration has.
    observations: BTreeSet<String>,
}

impl Survey {
    /// Surveys the names of the datasets, without reading any.
    pub(super) fn of(file: &File, demos: &[DemoName]) -> Result<Self, Hdf5Fault> {
        let mut survey = Self {
            demos: Vec::new(),
            states: true,
            observations: BTreeSet::new(),
        };
        for demo in demos {
            let group = format!("data/{}", demo.name);
            let lost = |fault: Hdf5Fault| match fault {
                fault if file.is_fatal(&fault) => Err(fault),
                // The fault is reported when the demonstration is read; it does not affect the decision.
                _ => Ok(Vec::new()),
            };
            let members = file.members(&group).or_else(lost)?;
            if members.is_empty() {
                continue;
            }
            let has = |members: &[String], name: &str| members.iter().any(|member| member == name);
            let observed = if has(&members, "obs") {
                let observations = file.members(&format!("{group}/obs")).or_else(lost)?;
                let lacks = OBSERVATIONS
                    .iter()
                    .find(|(name, _)| !has(&observations, name.trim_start_matches("obs/")));
                for name in observations {
                    if !survey.observations.contains(&name) {
                        survey.observations.insert(name);
                    }
                }
                lacks.map_or(Observed::Whole, |(name, _)| Observed::Lacks(name))
            } else {
                Observed::None
            };
            survey.demos.push((demo.name.clone(), observed));
            survey.states = survey.states && has(&members, "states") && model(file, &group)?;
            if file.is_cautious() {
                break;
            }
        }
        Ok(survey)
    }

    fn count(&self, which: impl Fn(&Observed) -> bool) -> usize {
        self.demos.iter().filter(|(_, observed)| which(observed)).count()
    }

    /// The layout to use. It is [`Layout::Raw`] if both of these conditions are met:
    ///
    /// * No demonstration has complete observations, or some have none and all others are complete.
    /// * All demonstrations have states and a model, or none has observations.
    fn layout(&self) -> Layout {
        let whole = self.count(|observed| *observed == Observed::Whole);
        let none = self.count(|observed| *observed == Observed::None);
        let by_states = whole == 0 || (none > 0 && whole + none == self.demos.len());
        let all_none = none == self.demos.len();
        if by_states && (self.states || all_none) {
            Layout::Raw
        } else {
            Layout::Observed
        }
    }

    /// What it found, for a choice of the `found` demonstrations of a file, which also has the members `others`.
    pub(super) fn surveyed(
        self,
        choice: &DemoChoice,
        found: usize,
        others: Vec<String>,
        demonstrations: usize,
    ) -> Surveyed {
        let lacks_objects = !self.observations.contains("object");
        Surveyed {
            choice: choice.clone(),
            demonstrations,
            found,
            others,
            layout: self.layout(),
            object_from_states: lacks_objects && self.states,
            lacks_objects,
            warning: self.warning(),
            observations: self.observations,
        }
    }

    /// A warning if observations exist but are not used.
    fn warning(&self) -> Option<Warning> {
        let unused: Vec<String> = self
            .demos
            .iter()
            .filter(|(_, observed)| *observed != Observed::None)
            .map(|(name, _)| name.clone())
            .collect();
        if self.layout() == Layout::Observed || unused.is_empty() {
            return None;
        }
        let lacking = self.demos.iter().find_map(|(name, observed)| match observed {
            Observed::Whole => None,
            Observed::Lacks(what) => Some(format!("{name} has no {what}")),
            Observed::None => Some(format!("{name} has no group obs")),
        });
        let message = format!(
            "the observations of {} are not used: {}, so all poses are computed from states and model_file",
            listed(&unused, ""),
            lacking.unwrap_or_default()
        );
        Some(Warning::new(WarningCode::UnusedObservations, message, unused.len()))
    }
}

fn model(file: &File, group: &str) -> Result<bool, Hdf5Fault> {
    match file.has_attribute(group, "model_file") {
        Err(fault @ Hdf5Fault::NeedsLibrary) => Err(fault),
        Err(_) => Ok(false),
        has => has,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn survey(observed: &[Observed], states: bool) -> Survey {
        let demos = (0..)
            .zip(observed)
            .map(|(i, observed): (u32, _)| (format!("demo_{i}"), observed.clone()));
        Survey {
            demos: demos.collect(),
            states,
            observations: BTreeSet::new(),
        }
    }

    #[test]
    fn the_chosen_layout_is_available_in_all_demonstrations() {
        use Observed::{Lacks, None, Whole};
        let lacks = || Lacks("obs/robot0_eef_pos");
        for (observed, states, layout, warned) in [
            (vec![Whole, Whole], true, Layout::Observed, false),
            (vec![Whole, Whole], false, Layout::Observed, false),
            (vec![None, None], true, Layout::Raw, false),
            (vec![None, None], false, Layout::Raw, false),
            // Some have no observations: the states, which all have, are used, with a warning.
            (vec![None, Whole], true, Layout::Raw, true),
            (vec![Whole, None], false, Layout::Observed, false),
            // All lack some observations: they have other names, or fewer were recorded.
            (vec![lacks(), lacks()], true, Layout::Raw, true),
            (vec![lacks(), lacks()], false, Layout::Observed, false),
            // One lacks some that the others have: this is a fault of that demonstration.
            (vec![Whole, lacks()], true, Layout::Observed, false),
            (vec![Whole, lacks(), None], true, Layout::Observed, false),
        ] {
            let survey = survey(&observed, states);
            assert_eq!(survey.layout(), layout, "{observed:?} {states}");
            assert_eq!(survey.warning().is_some(), warned, "{observed:?} {states}");
        }
    }
}

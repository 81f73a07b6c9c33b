//! What a dataset is, and what can be done with it.

use serde::{Deserialize, Serialize};

/// A description of a dataset for people and for programs.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Description {
    /// The format and its version.
    pub format: String,
    /// Its properties, in order.
    pub facts: Vec<Fact>,
    /// The task of a pipeline file for it; `None` if no task fits.
    pub task: Option<String>,
    /// What can be done with it.
    pub uses: Vec<Use>,
    /// What is unusual about it, one sentence each.
    pub notes: Vec<String>,
}

/// A property.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fact {
    /// Its name, one word.
    pub name: String,
    /// Its value.
    pub value: String,
}

/// A command, and whether it can use the dataset.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Use {
    /// The command.
    pub command: String,
    /// Whether it can.
    pub possible: bool,
    /// With which settings, or what is missing.
    pub how: String,
}

/// Stages in the order of a pipeline.
const COMMANDS: [&str; 4] = ["audit", "segment", "index", "rollout"];

impl Description {
    /// Adds a property.
    pub(crate) fn fact(&mut self, name: &str, value: impl Into<String>) {
        self.facts.push(Fact {
            name: name.to_owned(),
            value: value.into(),
        });
    }

    /// Adds a command that can be used.
    pub(crate) fn can(&mut self, command: &str, how: impl Into<String>) {
        self.set(command, true, how.into());
    }

    /// Adds commands that need what is missing.
    pub(crate) fn cannot(&mut self, commands: &[&str], missing: &str) {
        for command in commands {
            self.set(command, false, missing.to_owned());
        }
    }

    /// Adds that the dataset can only be audited and segmented, as that of an arm without an object. `gripper` states whether the
    /// gripper is known, `more` further settings that are needed, `missing` why indices and rollouts cannot be made.
    pub(crate) fn only_as_arm(&mut self, gripper: bool, more: &[String], missing: &str) {
        let rule = if gripper { "gripper" } else { "always_transit" };
        let mut settings = vec!["task = \"arm\"".to_owned(), format!("segment.rule = \"{rule}\"")];
        settings.extend_from_slice(more);
        let settings = settings.join(", ");
        self.can(
            "audit",
            format!("{settings}; the checks that do not need the pose of an object"),
        );
        self.can("segment", settings);
        self.cannot(&["index", "rollout"], missing);
    }

    /// Adds that nothing can be done.
    pub(crate) fn cannot_be_used(&mut self, missing: &str) {
        self.cannot(&COMMANDS, missing);
    }

    /// The description as lines, each with its indentation.
    pub fn lines(&self) -> Vec<(usize, String)> {
        let line = |indent: usize, name: &str, value: &str| (indent, format!("{name:<12} {value}"));
        let mut lines = vec![(0, self.format.clone())];
        lines.extend(self.facts.iter().map(|fact| line(2, &fact.name, &fact.value)));
        lines.extend(self.notes.iter().map(|note| line(2, "note", note)));
        lines.push(match &self.task {
            Some(task) => line(2, "pipeline", &format!("task = \"{task}\"")),
            None => line(2, "pipeline", "no task fits"),
        });
        let answer = |possible: bool| if possible { "yes" } else { "no" };
        let uses = self.uses.iter();
        lines.extend(uses.map(|each| line(4, &each.command, &format!("{}: {}", answer(each.possible), each.how))));
        lines
    }

    fn set(&mut self, command: &str, possible: bool, how: String) {
        self.uses.push(Use {
            command: command.to_owned(),
            possible,
            how,
        });
    }
}

/// `1 camera`, `2 cameras`.
pub(crate) fn counted(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

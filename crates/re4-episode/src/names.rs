//! Names of demonstrations.

/// Names of demonstrations in their source (`demo_4`, `episode 12`) by their numbers in the index.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct DemoNames(Vec<String>);

impl DemoNames {
    /// Creates the names of demonstrations 0, 1, ... of the index.
    pub fn new(names: Vec<String>) -> Self {
        Self(names)
    }

    /// Returns the name of a demonstration if it is known.
    pub fn get(&self, number: u32) -> Option<&str> {
        self.0.get(number as usize).map(String::as_str)
    }

    /// Returns the name of a demonstration for messages. If it is not known, the result contains the number in the index instead.
    pub fn of(&self, number: u32) -> String {
        self.get(number)
            .map_or_else(|| format!("demonstration {number} of the index"), str::to_owned)
    }
}

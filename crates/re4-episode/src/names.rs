//! What demonstrations are called.

/// Names of demonstrations in their source (`demo_4`, `episode 12`), by their numbers in the index.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct DemoNames(Vec<String>);

impl DemoNames {
    /// The names of demonstrations 0, 1, ...
    pub fn new(names: Vec<String>) -> Self {
        Self(names)
    }

    /// The name of a demonstration, where it is known.
    pub fn get(&self, number: u32) -> Option<&str> {
        self.0.get(number as usize).map(String::as_str)
    }

    /// What a sentence calls a demonstration: its name, and where that is not known its number in the index.
    pub fn of(&self, number: u32) -> String {
        self.get(number)
            .map_or_else(|| format!("demonstration {number} of the index"), str::to_owned)
    }
}

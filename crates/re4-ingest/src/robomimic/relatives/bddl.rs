//! Reads the parts of a LIBERO task file (BDDL) that name the moved object and the goal.
//!
//! A task file is one nested list. `(:obj_of_interest NAME NAME)` names the moved object and its target, and
//! `(:goal (And (On NAME NAME)))` the conditions of success. Source: LIBERO's task files; names of sections and predicates are in
//! any case.

/// Deepest nesting that is read. LIBERO's files nest seven levels deep.
const DEEPEST: usize = 64;

/// A condition of success, such as `(On bowl_1 plate_1)`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Predicate {
    /// Name of the predicate, as written.
    pub(super) name: String,
    /// What it is about.
    pub(super) about: Vec<String>,
}

impl Predicate {
    /// The object that is placed and what it is placed on or in; `None` for a predicate of another kind.
    pub(super) fn placement(&self) -> Option<(&str, &str)> {
        let places = ["on", "in"].iter().any(|name| self.name.eq_ignore_ascii_case(name));
        match &self.about[..] {
            [object, target] if places => Some((object, target)),
            _ => None,
        }
    }
}

impl std::fmt::Display for Predicate {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "({} {})", self.name, self.about.join(" "))
    }
}

/// What a task file says about the task.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Task {
    /// Objects of interest: first the moved one, then its target.
    pub(super) of_interest: Vec<String>,
    /// All conditions of success.
    pub(super) goals: Vec<Predicate>,
}

/// An element of a nested list.
enum Item {
    Word(String),
    List(Vec<Item>),
}

/// Parses a task file; the error says what is wrong.
pub(super) fn parse(text: &str) -> Result<Task, String> {
    let root = nested(text)?;
    let mut task = Task {
        of_interest: Vec::new(),
        goals: Vec::new(),
    };
    let mut goal = false;
    for item in &root {
        let Item::List(section) = item else { continue };
        let Some(Item::Word(name)) = section.first() else {
            continue;
        };
        if name.eq_ignore_ascii_case(":obj_of_interest") {
            task.of_interest.extend(words(&section[1..]));
        } else if name.eq_ignore_ascii_case(":goal") {
            goal = true;
            for condition in &section[1..] {
                conditions(condition, &mut task.goals);
            }
        }
    }
    if !goal || task.goals.is_empty() {
        return Err("it has no section (:goal ...) with conditions".to_owned());
    }
    Ok(task)
}

/// The elements of the outermost list.
fn nested(text: &str) -> Result<Vec<Item>, String> {
    let mut open: Vec<Vec<Item>> = Vec::new();
    let mut tokens = Vec::new();
    for line in text.lines() {
        let code = line.split(';').next().unwrap_or_default();
        let spaced = code.replace('(', " ( ").replace(')', " ) ");
        tokens.extend(spaced.split_whitespace().map(str::to_owned));
    }
    for token in tokens {
        match (token.as_str(), open.len()) {
            ("(", DEEPEST) => return Err(format!("its lists are nested more than {DEEPEST} levels deep")),
            ("(", _) => open.push(Vec::new()),
            (")", _) => {
                let Some(list) = open.pop() else { break };
                match open.last_mut() {
                    Some(outer) => outer.push(Item::List(list)),
                    None => return Ok(list),
                }
            }
            (word, _) => match open.last_mut() {
                Some(list) => list.push(Item::Word(word.to_owned())),
                None => return Err("it does not begin with a bracket".to_owned()),
            },
        }
    }
    Err("its brackets are not balanced".to_owned())
}

fn words(items: &[Item]) -> impl Iterator<Item = String> {
    items.iter().filter_map(|item| match item {
        Item::Word(word) => Some(word.clone()),
        Item::List(_) => None,
    })
}

/// Adds the conditions of a goal, and those in `And`.
fn conditions(item: &Item, goals: &mut Vec<Predicate>) {
    let Item::List(list) = item else { return };
    let Some(Item::Word(name)) = list.first() else {
        for inner in list {
            conditions(inner, goals);
        }
        return;
    };
    if name.eq_ignore_ascii_case("and") {
        for inner in &list[1..] {
            conditions(inner, goals);
        }
        return;
    }
    goals.push(Predicate {
        name: name.clone(),
        about: words(&list[1..]).collect(),
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    const TASK: &str = "(define (problem LIBERO_Floor_Manipulation)\n  (:domain robosuite)\n  (:language pick up the milk)\n (:fixtures floor - floor)\n  (:objects milk_1 - milk basket_1 - basket) ; a remark (\n  (:obj_of_interest\n    milk_1\n    basket_1\n  )\n  (:init (On milk_1 floor_other))\n  (:goal\n    (And (In milk_1 basket_1_contain_region))\n  )\n)\n";

    #[test]
    fn the_moved_object_and_the_goal_are_read() {
        let task = parse(TASK).unwrap();
        assert_eq!(task.of_interest, ["milk_1", "basket_1"]);
        assert_eq!(task.goals.len(), 1);
        assert_eq!(task.goals[0].placement(), Some(("milk_1", "basket_1_contain_region")));
        assert_eq!(task.goals[0].to_string(), "(In milk_1 basket_1_contain_region)");
    }

    #[test]
    fn all_conditions_are_read() {
        let two = TASK.replace("(And (In", "(and (Close drawer_1) (And (On a b)) (In");
        let task = parse(&two).unwrap();
        let names: Vec<_> = task.goals.iter().map(|goal| goal.name.as_str()).collect();
        assert_eq!(names, ["Close", "On", "In"]);
        assert_eq!(task.goals[0].placement(), None);
        let one = TASK.replace("(And (In milk_1 basket_1_contain_region))", "(On a b)");
        assert_eq!(parse(&one).unwrap().goals[0].placement(), Some(("a", "b")));
    }

    #[test]
    fn damaged_files_are_refused() {
        for (text, words) in [
            ("", "balanced"),
            ("milk", "bracket"),
            ("(define (:goal (On a b)", "balanced"),
            ("(define (:goal))", ":goal"),
            ("(define)", ":goal"),
        ] {
            let why = parse(text).unwrap_err();
            assert!(why.contains(words), "{text}: {why}");
        }
        assert!(parse(&"(".repeat(100)).unwrap_err().contains("nested"));
    }
}

//! Finds and orders the demonstrations of a file, and resolves which of them are requested.

use std::collections::BTreeSet;

use super::fault::Hdf5Fault;
use super::file::{File, Kind};
use super::reader::DemoChoice;
use crate::demos::DemoName;
use crate::name::SourceName;
use crate::selection::SelectionError;
use crate::warning::{Warning, WarningCode};

/// Maximum length of a demonstration's name in bytes; names are part of tables, pages and messages.
const MAX_NAME: usize = 200;

/// Names of the groups in `/data` that are demonstrations, and of the other members. If the others are `known`, no object is read.
pub(super) fn demonstrations(file: &File, known: Option<&[String]>) -> Result<(Vec<String>, Vec<String>), Hdf5Fault> {
    let names = file.members_or_none("data")?;
    if let Some(name) = names
        .iter()
        .find(|name| name.len() > MAX_NAME || name.chars().any(char::is_control))
    {
        let start: String = name.chars().take(40).collect();
        return Err(Hdf5Fault::Other(format!(
            "a group in /data has the name {start:?} of {} bytes; rename it to a name of at most {MAX_NAME} bytes without control characters, such as demo_0",
            name.len()
        )));
    }
    if let Some(others) = known {
        let of = |name: &String| !others.contains(name);
        return Ok((names.into_iter().filter(of).collect(), others.to_vec()));
    }
    let mut demos = Vec::new();
    let mut others = Vec::new();
    for name in names {
        let path = format!("data/{name}");
        // In cautious mode, the types of objects are not checked before the first demonstration is read.
        if file.is_cautious() && is_numbered(&name) {
            demos.push(name);
            continue;
        }
        let is_group = match file.kind(&path)? {
            Kind::Group => true,
            Kind::Dataset => false,
            // A dangling link with the name of a demonstration is a lost demonstration.
            Kind::Other => is_numbered(&name),
        };
        // A group with the name of a demonstration but without actions is a demonstration, too: its data is lost.
        let has_actions = || Ok::<_, Hdf5Fault>(is_numbered(&name) || file.exists(&format!("{path}/actions"))?);
        if is_group && has_actions()? {
            demos.push(name);
        } else {
            others.push(name);
        }
    }
    if demos.is_empty() {
        return Err(Hdf5Fault::NoData);
    }
    Ok((demos, others))
}

/// A warning about members of `/data` that are not demonstrations.
pub(super) fn others_warning(others: &[String]) -> Option<Warning> {
    let message = format!(
        "not ingested because they are not demonstrations: {}",
        listed(others, "/data/")
    );
    (!others.is_empty()).then(|| Warning::new(WarningCode::SkippedMembers, message, others.len()))
}

/// Whether a name ends in a digit, as those of demonstrations do.
fn is_numbered(name: &str) -> bool {
    name.ends_with(|last: char| last.is_ascii_digit())
}

/// Lists names for a message; of many, only the first ones.
pub(super) fn listed(names: &[String], prefix: &str) -> String {
    const SHOWN: usize = 8;
    let shown: Vec<String> = names.iter().take(SHOWN).map(|name| format!("{prefix}{name}")).collect();
    match names.len().checked_sub(SHOWN) {
        Some(more) if more > 0 => format!("{} and {more} more", shown.join(", ")),
        _ => shown.join(", "),
    }
}

/// Records for each demonstration which filter keys list it. Faults of filter keys that are not requested are warnings.
pub(super) fn mark_filter_keys(
    file: &File,
    choice: &DemoChoice,
    demos: &mut [DemoName],
    warnings: &mut Vec<Warning>,
) -> Result<(), Hdf5Fault> {
    let keys = match (file.members_or_none("mask"), &choice.filter) {
        (Ok(keys), _) => keys,
        (Err(fault), None) if !file.is_fatal(&fault) => {
            let message = format!("{fault}; no filter keys are available");
            warnings.push(Warning::new(WarningCode::SkippedFilterKeys, message, 1));
            return Ok(());
        }
        (Err(fault), _) => return Err(fault),
    };
    let mut unread = Vec::new();
    for key in &keys {
        let asked_for = choice.filter.as_ref() == Some(key);
        let listed = match file.names(&format!("mask/{key}")) {
            Ok(listed) => listed,
            Err(fault) if asked_for || file.is_fatal(&fault) => return Err(fault),
            Err(_) => {
                unread.push(key.clone());
                continue;
            }
        };
        if asked_for {
            let known: BTreeSet<&str> = demos.iter().map(|demo| demo.name.as_str()).collect();
            if let Some(name) = listed.iter().find(|name| !known.contains(name.as_str())) {
                return Err(Hdf5Fault::FilterNames {
                    filter: key.clone(),
                    demo: name.clone(),
                });
            }
        }
        let listed: BTreeSet<String> = listed.into_iter().collect();
        for demo in demos.iter_mut().filter(|demo| listed.contains(&demo.name)) {
            demo.filter_keys.push(key.clone());
        }
    }
    if !unread.is_empty() {
        let message = format!(
            "ignored because they are not lists of demonstrations: {}; correct them before using one as ingest.filter",
            listed(&unread, "/mask/")
        );
        warnings.push(Warning::new(WarningCode::SkippedFilterKeys, message, unread.len()));
    }
    match &choice.filter {
        Some(filter) if !keys.contains(filter) => Err(Hdf5Fault::UnknownFilter {
            filter: filter.clone(),
            known: keys,
        }),
        _ => Ok(()),
    }
}

/// The demonstrations that a choice selects.
pub(super) fn chosen(demos: &[DemoName], choice: &DemoChoice) -> Result<Vec<DemoName>, SelectionError> {
    let names: Vec<SourceName> = demos.iter().map(|demo| SourceName::new(&demo.name)).collect();
    let listed = |place: usize| match &choice.filter {
        Some(filter) => demos[place].filter_keys.contains(filter),
        None => true,
    };
    let places = choice.select.resolve_among(&names, &listed)?;
    Ok(places.into_iter().map(|place| demos[place].clone()).collect())
}

/// Orders demonstrations by [`SourceName`], and assigns their numbers.
pub(super) fn numbered(names: Vec<String>) -> Vec<DemoName> {
    let mut names: Vec<SourceName> = names.into_iter().map(SourceName::new).collect();
    names.sort_unstable();
    let own = |place: usize| Some(names.get(place)?.number()).flatten();
    // In this order, demonstrations with the same number are adjacent.
    let shared = |place: usize, number: u64| {
        let before = place.checked_sub(1).and_then(own);
        before == Some(number) || own(place + 1) == Some(number)
    };
    let numbers: Vec<Option<u32>> = (0..names.len())
        .map(|place| {
            let number = own(place).filter(|number| !shared(place, *number))?;
            u32::try_from(number).ok()
        })
        .collect();
    names
        .iter()
        .zip(numbers)
        .map(|(name, number)| DemoName {
            name: name.to_string(),
            number,
            filter_keys: Vec::new(),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::selection::Selection;

    #[test]
    fn demonstrations_are_ordered_by_their_numbers() {
        let names = [
            "demo_0",
            "demo_1",
            "demo_10",
            "demo_2",
            "extra",
            "demo_03",
            "b_1",
            "demo4294967296",
            "demo11",
        ];
        let numbered = numbered(names.map(str::to_owned).to_vec());
        let names: Vec<(&str, Option<u32>)> = numbered.iter().map(|demo| (demo.name.as_str(), demo.number)).collect();
        let expected = [
            ("demo_0", Some(0)),
            ("b_1", None),
            ("demo_1", None),
            ("demo_2", Some(2)),
            ("demo_03", Some(3)),
            ("demo_10", Some(10)),
            ("demo11", Some(11)),
            ("demo4294967296", None),
            ("extra", None),
        ];
        assert_eq!(names, expected);
    }

    #[test]
    fn a_selection_refers_to_numbers_of_demonstrations_in_the_filter() {
        let mut demos = numbered([0, 1, 3, 4, 6].map(|number| format!("demo_{number}")).to_vec());
        for demo in demos.iter_mut().filter(|demo| demo.number != Some(4)) {
            demo.filter_keys.push("train".to_owned());
        }
        let take = |filter: Option<&str>, select: Selection| {
            let filter = filter.map(str::to_owned);
            let chosen = chosen(
                &demos,
                &DemoChoice {
                    filter,
                    select,
                    cautious: false,
                },
            )
            .map_err(|error| error.to_string())?;
            Ok(chosen.into_iter().map(|demo| demo.name).collect::<Vec<_>>().join(" "))
        };
        let three = || Selection::List(vec![3.into()]);
        let four = || Selection::List(vec![4.into()]);
        assert_eq!(take(None, three()), Ok("demo_3".to_owned()));
        assert_eq!(take(Some("train"), three()), Ok("demo_3".to_owned()));
        assert_eq!(take(Some("train"), Selection::Last(2)), Ok("demo_3 demo_6".to_owned()));
        assert_eq!(take(None, four()), Ok("demo_4".to_owned()));
        let refused: Result<String, String> = take(Some("train"), four());
        assert!(refused.unwrap_err().contains("the filter key does not list demo_4"));
    }
}

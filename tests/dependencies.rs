//! Checks the rules of `deny.toml` for dependencies (licences, sources, bans, duplicates) without an additional tool.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::support::repository;

fn deny() -> toml::Table {
    std::fs::read_to_string(repository().join("deny.toml"))
        .unwrap()
        .parse()
        .unwrap()
}

/// All packages in the lock file, for all platforms.
fn packages() -> Vec<Value> {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--locked", "--offline"])
        .current_dir(repository())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).unwrap();
    let packages = metadata["packages"].as_array().unwrap().clone();
    assert!(packages.len() > 100);
    packages
}

/// Packages that are built on any platform with all features, as `name v1.2.3`. The lock file has more, for optional parts of
/// dependencies that are never enabled.
fn built() -> BTreeSet<String> {
    let output = Command::new(env!("CARGO"))
        .args([
            "tree",
            "--workspace",
            "--all-features",
            "--target",
            "all",
            "--locked",
            "--offline",
        ])
        .args(["--prefix", "none", "--format", "{p}"])
        .current_dir(repository())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines()
        .map(|line| line.split_whitespace().take(2).collect::<Vec<_>>().join(" "))
        .collect()
}

fn text<'a>(package: &'a Value, key: &str) -> &'a str {
    package[key].as_str().unwrap_or_default()
}

/// The licence of a package. Some packages name it only as a file, for which `deny.toml` has the expression.
fn licence<'a>(package: &'a Value, deny: &'a toml::Table) -> &'a str {
    let named = text(package, "license");
    if !named.is_empty() {
        return named;
    }
    let clarified = deny["licenses"]["clarify"].as_array().unwrap();
    let entry = clarified
        .iter()
        .find(|entry| entry["crate"].as_str() == Some(text(package, "name")));
    entry.map_or("", |entry| entry["expression"].as_str().unwrap())
}

/// Whether the allowed licences satisfy an SPDX expression with `OR`, `AND`, `WITH`, parentheses, and the slash that older
/// packages use for `OR`.
fn is_met(expression: &str, allowed: &BTreeSet<&str>) -> bool {
    let spaced = expression.replace('(', " ( ").replace(')', " ) ").replace('/', " OR ");
    let words: Vec<&str> = spaced.split_whitespace().collect();
    let (met, rest) = any_of(&words, allowed);
    assert!(rest.is_empty(), "unreadable licence {expression:?}");
    met
}

fn any_of<'a, 'b>(words: &'b [&'a str], allowed: &BTreeSet<&str>) -> (bool, &'b [&'a str]) {
    let (mut met, mut rest) = all_of(words, allowed);
    while let Some((&"OR", after)) = rest.split_first() {
        let (other, after) = all_of(after, allowed);
        (met, rest) = (met | other, after);
    }
    (met, rest)
}

fn all_of<'a, 'b>(words: &'b [&'a str], allowed: &BTreeSet<&str>) -> (bool, &'b [&'a str]) {
    let (mut met, mut rest) = single(words, allowed);
    while let Some((&"AND", after)) = rest.split_first() {
        let (other, after) = single(after, allowed);
        (met, rest) = (met & other, after);
    }
    (met, rest)
}

fn single<'a, 'b>(words: &'b [&'a str], allowed: &BTreeSet<&str>) -> (bool, &'b [&'a str]) {
    match words {
        ["(", inner @ ..] => {
            let (met, rest) = any_of(inner, allowed);
            (met, rest.strip_prefix(&[")"]).unwrap_or(rest))
        }
        [licence, "WITH", exception, rest @ ..] => {
            (allowed.contains(format!("{licence} WITH {exception}").as_str()), rest)
        }
        [licence, rest @ ..] => (allowed.contains(licence), rest),
        [] => (false, words),
    }
}

#[test]
fn licences_are_allowed() {
    let deny = deny();
    let list = deny["licenses"]["allow"].as_array().unwrap();
    let allowed: BTreeSet<&str> = list.iter().map(|licence| licence.as_str().unwrap()).collect();
    let built = built();
    let packages: Vec<Value> = packages()
        .into_iter()
        .filter(|package| built.contains(&format!("{} v{}", text(package, "name"), text(package, "version"))))
        .collect();
    assert!(packages.len() > 100);
    let refused: Vec<String> = packages
        .iter()
        .filter(|package| !is_met(licence(package, &deny), &allowed))
        .map(|package| format!("{} ({})", text(package, "name"), licence(package, &deny)))
        .collect();
    assert!(refused.is_empty(), "{refused:?}");
    // A licence that no package needs should not be allowed.
    for own in &allowed {
        let fewer: BTreeSet<&str> = allowed.iter().copied().filter(|other| other != own).collect();
        let needed = packages.iter().any(|package| !is_met(licence(package, &deny), &fewer));
        assert!(
            needed || ["MIT", "Apache-2.0"].contains(own),
            "{own} is allowed, but no package needs it"
        );
    }
}

#[test]
fn licence_expressions_are_understood() {
    let allowed = BTreeSet::from(["MIT", "Zlib", "Apache-2.0 WITH LLVM-exception"]);
    for met in [
        "MIT",
        "GPL-3.0 OR MIT",
        "GPL-3.0/MIT",
        "MIT AND Zlib",
        "MIT AND (GPL-3.0 OR Zlib)",
        "Apache-2.0 WITH LLVM-exception OR X",
    ] {
        assert!(is_met(met, &allowed), "{met}");
    }
    for refused in [
        "",
        "GPL-3.0",
        "MIT AND GPL-3.0",
        "(MIT OR Zlib) AND GPL-3.0",
        "Apache-2.0",
    ] {
        assert!(!is_met(refused, &allowed), "{refused}");
    }
}

#[test]
fn all_dependencies_come_from_one_registry() {
    let packages = packages();
    let sources: BTreeSet<&str> = packages
        .iter()
        .filter_map(|package| package["source"].as_str())
        .collect();
    assert_eq!(sources.len(), 1, "{sources:?}");
    assert!(
        sources.iter().all(|source| source.starts_with("registry+")),
        "{sources:?}"
    );
    let root = repository();
    for package in packages.iter().filter(|package| package["source"].is_null()) {
        assert!(
            Path::new(text(package, "manifest_path")).starts_with(root.join("crates")),
            "{} is outside of the workspace",
            text(package, "name")
        );
    }
    let lock: toml::Table = std::fs::read_to_string(root.join("Cargo.lock"))
        .unwrap()
        .parse()
        .unwrap();
    for package in lock["package"].as_array().unwrap() {
        assert_eq!(
            package.get("source").is_some(),
            package.get("checksum").is_some(),
            "{package}"
        );
    }
}

#[test]
fn banned_crates_are_not_used() {
    let deny = deny();
    let list = deny["bans"]["deny"].as_array().unwrap();
    let banned: BTreeSet<&str> = list.iter().map(|entry| entry["crate"].as_str().unwrap()).collect();
    assert!(banned.contains("openssl-sys"));
    for package in packages() {
        assert!(
            !banned.contains(text(&package, "name")),
            "{} is banned",
            text(&package, "name")
        );
    }
}

#[test]
fn libraries_with_public_types_have_one_version() {
    let mut versions: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for package in packages() {
        let version = text(&package, "version").to_owned();
        versions
            .entry(text(&package, "name").to_owned())
            .or_default()
            .insert(version);
    }
    for name in [
        "arrow-array",
        "arrow-schema",
        "parquet",
        "zarrs",
        "nalgebra",
        "rayon",
        "serde",
        "serde_json",
    ] {
        let found = versions
            .get(name)
            .unwrap_or_else(|| panic!("{name} is not used; remove it from this list"));
        assert_eq!(found.len(), 1, "{name} has several versions: {found:?}");
    }
}

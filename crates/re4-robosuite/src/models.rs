//! Adapts the `model_file` of a demonstration to another machine than the one that recorded it.
//!
//! The model refers to meshes and textures by absolute paths inside robosuite's package, wherever it was installed. Everything up
//! to and including the last path element `robosuite` is replaced by the folder that contains the same files on this machine.
//! robosuite does the same when it loads a demonstration.

use re4_fault::Remedy;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use roxmltree::{Document, Node};
use thiserror::Error;

/// Path element after which a path is the same on every machine.
const PACKAGE: &str = "robosuite";

/// Reasons why the files that a model refers to cannot be found. The caller adds the names of the file and the demonstration.
#[derive(Debug, Clone, PartialEq, Eq, Error, Remedy)]
pub enum AssetsError {
    /// The text is not XML.
    #[error("the model is not valid XML: {0}")]
    Xml(String),
    /// The XML is not an MJCF model.
    #[error("the model's root element is <{0}>, not <mujoco>")]
    Root(String),
    /// The model includes another file.
    #[error("the model includes another file ({0})")]
    #[remedy("use a complete model, as mj_saveLastXML writes it")]
    Include(String),
    /// The path of a file has no element `robosuite`.
    #[error(
        "the model refers to the file {0}, which is not in a folder {PACKAGE}, so its path on this machine is unknown"
    )]
    Foreign(String),
    /// A file does not exist.
    #[error("the model refers to the file {named}, which does not exist at {}", path.display())]
    #[remedy(
        "run scripts/setup-simulators.sh, or set the environment variable RE4_SIMULATORS to the folder that it created"
    )]
    Missing {
        /// The path in the model.
        named: String,
        /// The path on this machine.
        path: PathBuf,
    },
}

/// Rewrites the paths of meshes, textures and height fields in a model to paths in `folder`, which replaces the folder
/// `robosuite` of the package: `/any/where/robosuite/models/assets/x.stl` becomes `folder/models/assets/x.stl`. The rest of the
/// text is kept byte for byte.
///
/// # Errors
/// If the text is not MJCF, includes another file, or refers to a file that is not in `folder`.
pub fn with_assets(mjcf: &str, folder: &Path) -> Result<String, AssetsError> {
    let document = Document::parse(mjcf).map_err(|error| AssetsError::Xml(error.to_string()))?;
    let root = document.root_element();
    if root.tag_name().name() != "mujoco" {
        return Err(AssetsError::Root(root.tag_name().name().to_owned()));
    }
    let mut rewritten = String::with_capacity(mjcf.len());
    let mut copied = 0;
    for node in document.descendants().filter(Node::is_element) {
        if node.tag_name().name() == "include" {
            let file = node.attribute("file").unwrap_or_default();
            return Err(AssetsError::Include(file.to_owned()));
        }
        for attribute in node.attributes() {
            if !attribute.name().starts_with("file") || attribute.value().is_empty() {
                continue;
            }
            let path = place(attribute.value(), folder)?;
            let range = attribute.range_value();
            rewritten.push_str(&mjcf[copied..range.start]);
            escape(&path.to_string_lossy(), &mut rewritten);
            copied = range.end;
        }
    }
    rewritten.push_str(&mjcf[copied..]);
    Ok(rewritten)
}

/// The appearance of a model, with the sizes of its boxes separated from the rest.
#[derive(Debug, Clone, PartialEq)]
pub struct Appearance {
    /// The text of the model without the sizes of named boxes. Images of two models with the same text differ only because of
    /// `boxes`.
    pub rest: String,
    /// Names and half sizes (metres) of the boxes.
    pub boxes: Vec<(String, [f64; 3])>,
}

/// Splits a model into the sizes of its named boxes and the rest. robosuite samples the size of Lift's cube for every
/// demonstration, so each demonstration has its own model.
///
/// The mean size (attribute `meansize` of `statistic`) is left out as well: only decorations that are not rendered depend on it.
///
/// # Errors
/// If the text is not XML.
pub fn split_appearance(mjcf: &str) -> Result<Appearance, AssetsError> {
    let document = Document::parse(mjcf).map_err(|error| AssetsError::Xml(error.to_string()))?;
    let mut boxes = Vec::new();
    let mut rest = String::with_capacity(mjcf.len());
    let mut copied = 0;
    for node in document.descendants() {
        let attribute = match node.tag_name().name() {
            "statistic" => node.attribute_node("meansize"),
            "geom" if node.attribute("type") == Some("box") => node.attribute_node("size"),
            _ => None,
        };
        let Some(attribute) = attribute else { continue };
        if node.tag_name().name() == "geom" {
            let numbers: Result<Vec<f64>, _> = attribute.value().split_ascii_whitespace().map(str::parse).collect();
            let size = numbers.ok().and_then(|numbers| <[f64; 3]>::try_from(numbers).ok());
            let (Some(name), Some(size)) = (node.attribute("name"), size) else {
                continue;
            };
            boxes.push((name.to_owned(), size));
        }
        let range = attribute.range_value();
        rest.push_str(&mjcf[copied..range.start]);
        copied = range.end;
    }
    rest.push_str(&mjcf[copied..]);
    Ok(Appearance { rest, boxes })
}

/// The path on this machine of a file that a model refers to.
fn place(named: &str, folder: &Path) -> Result<PathBuf, AssetsError> {
    let foreign = || AssetsError::Foreign(named.to_owned());
    // Models that were recorded on Windows use backslashes, or a mixture of both.
    let elements: Vec<&str> = named.split(['/', '\\']).collect();
    let package = elements
        .iter()
        .rposition(|&element| element == PACKAGE)
        .ok_or_else(foreign)?;
    // `arenas/../textures` is resolved without the file system: `folder` may contain only those files that models use, so `arenas`
    // may not exist.
    let mut below: Vec<&str> = Vec::new();
    for &element in &elements[package + 1..] {
        match element {
            "" | "." => {}
            ".." => {
                below.pop().ok_or_else(foreign)?;
            }
            element => below.push(element),
        }
    }
    let mut path = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    path.extend(below);
    if !path.is_file() {
        return Err(AssetsError::Missing {
            named: named.to_owned(),
            path,
        });
    }
    Ok(path)
}

/// Escapes a text for an attribute value in single or double quotes.
fn escape(text: &str, out: &mut String) {
    for letter in text.chars() {
        match letter {
            '&' | '<' | '>' | '"' | '\'' => {
                // Writing to a string cannot fail.
                let _ = write!(out, "&#{};", u32::from(letter));
            }
            letter => out.push(letter),
        }
    }
}

//! A demonstration's `model_file` on another machine than the one that recorded it.
//!
//! The model names meshes and textures by absolute paths below robosuite's package, wherever that was installed. As robosuite
//! itself does when it loads a demonstration, everything up to and including the last path element `robosuite` is replaced by
//! the folder that holds the same files here.

use re4_fault::Remedy;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use roxmltree::{Document, Node};
use thiserror::Error;

/// Path element after which a path is the same on every machine.
const PACKAGE: &str = "robosuite";

/// Why the files that a model names cannot be found. The caller says in which file and demonstration the model is.
#[derive(Debug, Clone, PartialEq, Eq, Error, Remedy)]
pub enum AssetsError {
    /// The text is not XML.
    #[error("the model is not readable as XML: {0}")]
    Xml(String),
    /// The XML is something else.
    #[error("the model's root element is <{0}>, not <mujoco>")]
    Root(String),
    /// Another file would become part of the model.
    #[error("the model includes another file ({0})")]
    #[remedy("give one that is whole, as mj_saveLastXML writes it")]
    Include(String),
    /// The path does not lead through robosuite's package.
    #[error("the model names the file {0}, which is not below a folder {PACKAGE}, so its place here is unknown")]
    Foreign(String),
    /// The file is not there.
    #[error("the model names the file {named}, which is not at {}", path.display())]
    #[remedy(
        "run scripts/setup-simulators.sh, or name the folder that it made in the environment variable RE4_SIMULATORS"
    )]
    Missing {
        /// As the model has it.
        named: String,
        /// Where it was looked for.
        path: PathBuf,
    },
}

/// The model with the paths of its meshes, textures and height fields rewritten to files below `folder`, which stands for the
/// folder `robosuite` of the package: `/any/where/robosuite/models/assets/x.stl` becomes `folder/models/assets/x.stl`. The
/// rest of the text is kept as it is, byte for byte.
///
/// # Errors
/// When the text is no MJCF, includes another file, or names a file that is not below `folder`.
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

/// What a model looks like, apart from the sizes of its boxes.
#[derive(Debug, Clone, PartialEq)]
pub struct Looks {
    /// The text without those sizes; models with the same one differ in `boxes` alone, as far as images go.
    pub rest: String,
    /// Names and half sizes of the boxes, in metres.
    pub boxes: Vec<(String, [f64; 3])>,
}

/// Takes a model apart into sizes of named boxes and the rest. robosuite draws the size of Lift's cube anew for every
/// demonstration, so that each has a model of its own.
///
/// The mean size of everything (attribute `meansize` of `statistic`) is left out, too: only marks that are not drawn depend
/// on it.
///
/// # Errors
/// When the text is not XML.
pub fn looks(mjcf: &str) -> Result<Looks, AssetsError> {
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
    Ok(Looks { rest, boxes })
}

/// Where a file that a model names is here.
fn place(named: &str, folder: &Path) -> Result<PathBuf, AssetsError> {
    let foreign = || AssetsError::Foreign(named.to_owned());
    // A model that was recorded on Windows has backslashes between the elements, or both.
    let elements: Vec<&str> = named.split(['/', '\\']).collect();
    let package = elements
        .iter()
        .rposition(|&element| element == PACKAGE)
        .ok_or_else(foreign)?;
    // `arenas/../textures` is taken by its words: the folder here may lack what no model uses.
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

/// As the value of an attribute in either kind of quotes.
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

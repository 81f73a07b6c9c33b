//! The part of a model that physics depends on.

use std::collections::BTreeSet;
use std::ops::Range;

use roxmltree::{Document, Node};

/// A model without what is only drawn: geoms that touch nothing and add no weight, textures, materials, and the meshes that no
/// other geom has. It compiles much faster, and moves as the whole model does, to the bit.
///
/// A geom of no mass stays where the weight of a moving body comes from its geoms: MuJoCo turns the inertia of a body with
/// several geoms to its principal axes by iteration, with an error of some 10⁻⁶ that the body would otherwise not have.
///
/// # Errors
/// When the text is not XML, with the parser's words.
pub fn without_images(mjcf: &str) -> Result<String, String> {
    let document = Document::parse(mjcf).map_err(|error| error.to_string())?;
    let elements = || document.descendants().filter(Node::is_element);
    let mut used: BTreeSet<&str> = BTreeSet::new();
    let mut cuts: Vec<Range<usize>> = Vec::new();
    for node in elements() {
        match node.tag_name().name() {
            "geom" if only_drawn(&node) => cuts.push(node.range()),
            name => {
                if name == "geom" {
                    used.extend(node.attribute("mesh"));
                }
                let material = node.attributes().find(|attribute| attribute.name() == "material");
                cuts.extend(material.map(|attribute| attribute.range()));
            }
        }
    }
    for asset in elements().filter(|node| node.has_tag_name("asset")) {
        for node in asset.children().filter(Node::is_element) {
            let drawn = match node.tag_name().name() {
                "texture" | "material" => true,
                // A mesh without a name has that of its file.
                "mesh" => node.attribute("name").is_some_and(|name| !used.contains(name)),
                _ => false,
            };
            if drawn {
                cuts.push(node.range());
            }
        }
    }
    cuts.sort_by_key(|cut| cut.start);
    let mut text = String::with_capacity(mjcf.len());
    let mut copied = 0;
    for cut in cuts {
        // An attribute of an element that is cut out itself.
        if cut.start < copied {
            continue;
        }
        text.push_str(&mjcf[copied..cut.start]);
        copied = cut.end;
    }
    text.push_str(&mjcf[copied..]);
    Ok(text)
}

/// A model in which the geoms of some bodies, by name, touch nothing. Their weight stays.
///
/// # Errors
/// When the text is not XML, with the parser's words.
pub fn without_contacts(mjcf: &str, bodies: &[impl AsRef<str>]) -> Result<String, String> {
    let document = Document::parse(mjcf).map_err(|error| error.to_string())?;
    let mut edits: Vec<(Range<usize>, &str)> = Vec::new();
    let named = |node: &Node| {
        node.has_tag_name("body")
            && node
                .attribute("name")
                .is_some_and(|name| bodies.iter().any(|body| body.as_ref() == name))
    };
    for body in document.descendants().filter(named) {
        for geom in body.descendants().filter(|node| node.has_tag_name("geom")) {
            for name in ["contype", "conaffinity"] {
                if let Some(attribute) = geom.attributes().find(|attribute| attribute.name() == name) {
                    edits.push((attribute.range(), ""));
                }
            }
            let after = geom.range().start + "<geom".len();
            edits.push((after..after, " contype=\"0\" conaffinity=\"0\""));
        }
    }
    edits.sort_by_key(|(range, _)| std::cmp::Reverse(range.start));
    let mut text = mjcf.to_owned();
    for (range, with) in edits {
        text.replace_range(range, with);
    }
    Ok(text)
}

/// Whether a geom neither touches anything nor takes part in the weight of a body that moves.
fn only_drawn(geom: &Node) -> bool {
    let zero = |name: &str| {
        geom.attribute(name)
            .is_some_and(|value| value.trim().parse() == Ok(0.0))
    };
    // The weight of a body that says it itself does not come from its geoms.
    let weighed = geom
        .parent()
        .is_some_and(|body| body.children().any(|child| child.has_tag_name("inertial")));
    let fixed = geom.parent().is_some_and(|body| {
        !body.ancestors().any(|node| {
            node.children()
                .any(|child| child.has_tag_name("joint") || child.has_tag_name("freejoint"))
        })
    });
    zero("contype") && zero("conaffinity") && (weighed || fixed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keeps_what_touches_or_weighs() {
        let model = r#"<mujoco><asset><texture name="t"/><material name="m" texture="t"/><mesh name="seen"/><mesh name="felt"/></asset>
            <worldbody><geom name="floor" material="m"/><body><joint/>
            <geom name="a" mesh="felt" material="m" rgba="1 0 0 1"/>
            <geom name="b" contype="0" conaffinity="0" mass="0"/><geom name="c" contype="0" mass="0"/></body>
            <body><joint/><inertial/><geom name="d" mesh="seen" contype="0" conaffinity="0"/></body>
            <body><geom name="e" mesh="seen" contype="0" conaffinity="0"/></body></worldbody></mujoco>"#;
        let text = without_images(model).unwrap();
        let document = Document::parse(&text).unwrap();
        let names: Vec<_> = document
            .descendants()
            .filter(|node| node.has_tag_name("geom"))
            .filter_map(|node| node.attribute("name"))
            .collect();
        assert_eq!(names, ["floor", "a", "b", "c"]);
        assert!(
            !text.contains("material") && !text.contains("texture") && !text.contains("seen"),
            "{text}"
        );
        assert!(text.contains(r#"mesh="felt""#) && text.contains(r#"rgba="1 0 0 1""#));
        assert!(without_images("<a>").is_err());
        let model =
            r#"<a><body name="x"><geom size="1"/><body><geom conaffinity="1" size="2"/></body></body><geom/></a>"#;
        assert_eq!(
            without_contacts(model, &["x"]).unwrap(),
            r#"<a><body name="x"><geom contype="0" conaffinity="0" size="1"/><body><geom contype="0" conaffinity="0"  size="2"/></body></body><geom/></a>"#
        );
    }
}

//! Reduces a model to the parts that physics depends on.

use std::collections::BTreeSet;
use std::ops::Range;

use roxmltree::{Document, Node};

/// Removes the purely visual parts of a model: geoms without contacts and mass, textures, materials, and meshes that no other
/// geom uses. The reduced model compiles much faster, and its motion is bit-exact with that of the whole model.
///
/// A geom without mass is kept if the mass of a moving body comes from its geoms. For a body with several geoms, MuJoCo computes
/// the principal axes of inertia by iteration, with an error of about 10⁻⁶. Without one of its geoms, the body might not have this
/// error.
///
/// # Errors
/// If the text is not XML. The error is the parser's message.
pub fn without_visuals(mjcf: &str) -> Result<String, String> {
    let document = Document::parse(mjcf).map_err(|error| error.to_string())?;
    let elements = || document.descendants().filter(Node::is_element);
    let mut used: BTreeSet<&str> = BTreeSet::new();
    let mut cuts: Vec<Range<usize>> = Vec::new();
    for node in elements() {
        match node.tag_name().name() {
            "geom" if is_visual(&node) => cuts.push(node.range()),
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
            let visual = match node.tag_name().name() {
                "texture" | "material" => true,
                // A mesh without a name is kept: its name is that of its file, so geoms may refer to it.
                "mesh" => node.attribute("name").is_some_and(|name| !used.contains(name)),
                _ => false,
            };
            if visual {
                cuts.push(node.range());
            }
        }
    }
    cuts.sort_by_key(|cut| cut.start);
    let mut text = String::with_capacity(mjcf.len());
    let mut copied = 0;
    for cut in cuts {
        // Skip attributes of elements that are cut themselves.
        if cut.start < copied {
            continue;
        }
        text.push_str(&mjcf[copied..cut.start]);
        copied = cut.end;
    }
    text.push_str(&mjcf[copied..]);
    Ok(text)
}

/// Disables the contacts of all geoms of the named bodies and their descendants. Their masses stay.
///
/// # Errors
/// If the text is not XML. The error is the parser's message.
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
    // From the end to the start, so that edits do not move the ranges of those that follow.
    edits.sort_by_key(|(range, _)| std::cmp::Reverse(range.start));
    let mut text = mjcf.to_owned();
    for (range, with) in edits {
        text.replace_range(range, with);
    }
    Ok(text)
}

/// Whether a geom has no contacts and does not contribute to the inertia of a moving body.
fn is_visual(geom: &Node) -> bool {
    let zero = |name: &str| {
        geom.attribute(name)
            .is_some_and(|value| value.trim().parse() == Ok(0.0))
    };
    // If a body has an element `inertial`, its inertia does not come from its geoms.
    let explicit_inertia = geom
        .parent()
        .is_some_and(|body| body.children().any(|child| child.has_tag_name("inertial")));
    let fixed = geom.parent().is_some_and(|body| {
        !body.ancestors().any(|node| {
            node.children()
                .any(|child| child.has_tag_name("joint") || child.has_tag_name("freejoint"))
        })
    });
    zero("contype") && zero("conaffinity") && (explicit_inertia || fixed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn geoms_with_contacts_or_mass_are_kept() {
        let model = r#"<mujoco><asset><texture name="t"/><material name="m" texture="t"/><mesh name="seen"/><mesh name="felt"/></asset>
            <worldbody><geom name="floor" material="m"/><body><joint/>
            <geom name="a" mesh="felt" material="m" rgba="1 0 0 1"/>
            <geom name="b" contype="0" conaffinity="0" mass="0"/><geom name="c" contype="0" mass="0"/></body>
            <body><joint/><inertial/><geom name="d" mesh="seen" contype="0" conaffinity="0"/></body>
            <body><geom name="e" mesh="seen" contype="0" conaffinity="0"/></body></worldbody></mujoco>"#;
        let text = without_visuals(model).unwrap();
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
        assert!(without_visuals("<a>").is_err());
        let model =
            r#"<a><body name="x"><geom size="1"/><body><geom conaffinity="1" size="2"/></body></body><geom/></a>"#;
        assert_eq!(
            without_contacts(model, &["x"]).unwrap(),
            r#"<a><body name="x"><geom contype="0" conaffinity="0" size="1"/><body><geom contype="0" conaffinity="0"  size="2"/></body></body><geom/></a>"#
        );
    }
}

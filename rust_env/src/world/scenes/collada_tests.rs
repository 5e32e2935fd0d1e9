//! COLLADA files in all the spellings that were met.
use std::path::Path;

use glam::DVec3;

use super::collada::read;
use super::part::Part;
use super::LoadOptions;
use crate::error::Result;

/// A square of 2 x 2 units in z = 0 as one polygon, whose ids all collide across element types.
pub(super) const SQUARE: &str = r##"<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="0.01" name="meter"/><up_axis>Y_UP</up_axis></asset>
<library_geometries><geometry id="a b" name="x"><mesh>
 <source id="s"><float_array id="a b" count="13">99 0 0 0 2 0 0 2 2 0 0 2 0</float_array>
  <technique_common><accessor source="#a b" count="4" offset="1" stride="3"/></technique_common></source>
 <vertices id="v"><input semantic="NORMAL" source="#a b"/><input semantic="POSITION" source="#s"/></vertices>
 <lines count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1</p></lines>
 <triangles count="0"/>
 <polylist count="1"><input semantic="NORMAL" source="#s" offset="0"/><input semantic="VERTEX" source="#v" offset="1"/>
  <vcount>4</vcount><p>9 0 9 1 9 2 9 3</p></polylist>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="a b"><node id="a b">
 <matrix>1 0 0 100 0 1 0 0 0 0 1 0 0 0 0 1</matrix>
 <instance_geometry url="#a b"/>
</node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#a b"/></scene>
</COLLADA>"##;

fn read_text(text: &str, options: &LoadOptions) -> Result<(Part, Vec<String>)> {
    let mut notes = Vec::new();
    let part = read(
        Path::new("a.dae"),
        text.as_bytes().to_vec(),
        options,
        &mut notes,
    )?;
    Ok((part, notes))
}

fn lenient(text: &str) -> Part {
    read_text(text, &LoadOptions::default()).unwrap().0
}

fn assert_vertices(part: &Part, expected: &[[f64; 3]]) {
    assert_eq!(part.vertices.len(), expected.len());
    for (found, expected) in part.vertices.iter().zip(expected) {
        let error = (*found - DVec3::from(*expected)).length();
        assert!(error < 1e-12, "{found} instead of {expected:?}");
    }
}

#[test]
fn ids_are_looked_up_by_element_type() {
    let part = lenient(SQUARE);
    assert_eq!(part.triangles, [[0, 1, 2], [0, 2, 3]]);
    let corners = [
        [1.0, 0.0, 0.0],
        [1.02, 0.0, 0.0],
        [1.02, 0.02, 0.0],
        [1.0, 0.02, 0.0],
    ];
    assert_vertices(&part, &corners);
}

#[test]
fn the_up_axis_counts_only_on_demand() {
    let honour = LoadOptions {
        honour_up_axis: true,
        ..LoadOptions::default()
    };
    let turned = |tag: &str| read_text(&SQUARE.replace("Y_UP", tag), &honour).unwrap().0;
    assert_vertices(
        &turned("Y_UP"),
        &[
            [1.0, 0.0, 0.0],
            [1.02, 0.0, 0.0],
            [1.02, 0.0, 0.02],
            [1.0, 0.0, 0.02],
        ],
    );
    assert_eq!(turned("Z_UP"), lenient(SQUARE));
    // Up is x, right is -y: the point (1.02, 0.02, 0) is at height 1.02.
    let x_up = turned("X_UP");
    assert!((x_up.vertices[2] - DVec3::new(-0.02, 0.0, 1.02)).length() < 1e-12);
}

#[test]
fn transforms_compose_in_the_order_of_the_document() {
    let matrix = "<matrix>1 0 0 100 0 1 0 0 0 0 1 0 0 0 0 1</matrix>";
    let steps = "<translate>0 0 100</translate><rotate>0 0 2 90</rotate><scale>1 2 -1</scale>";
    let part = lenient(&SQUARE.replace(matrix, steps));
    assert_vertices(
        &part,
        &[
            [0.0, 0.0, 1.0],
            [0.0, 0.02, 1.0],
            [-0.04, 0.02, 1.0],
            [-0.04, 0.0, 1.0],
        ],
    );
}

#[test]
fn nested_and_instanced_nodes() {
    // A library node that instances another one, twice; the scene's own node nests.
    let library = r##"<library_nodes><node id="n"><instance_node url="#m"/><node><translate>0 0 1</translate>
        <instance_node url="#m"/></node></node>
        <node id="m"><instance_geometry url="#a b"/><instance_geometry url="#a b"/></node></library_nodes><library_visual_scenes>"##;
    let text = SQUARE.replace("<library_visual_scenes>", library).replace(
        r##"<instance_geometry url="#a b"/>
</node></visual"##,
        r##"<node><instance_node url="#n"/></node>
</node></visual"##,
    );
    let part = lenient(&text);
    assert_eq!(part.triangles.len(), 8);
    assert!((part.vertices[15] - DVec3::new(1.0, 0.02, 0.01)).length() < 1e-12);
    // A node inside itself ends with a message.
    let endless = text.replace(r##"url="#m""##, r##"url="#n""##);
    let error = read_text(&endless, &LoadOptions::default())
        .unwrap_err()
        .to_string();
    assert!(error.contains("levels"), "{error}");
}

#[test]
fn every_primitive_is_read() {
    let polylist = SQUARE.find("<polylist").unwrap()..SQUARE.find("</polylist>").unwrap() + 11;
    let with = |primitive: &str| {
        let mut text = SQUARE.to_owned();
        let input = r##"<input semantic="VERTEX" source="#v" offset="0"/>"##;
        text.replace_range(polylist.clone(), &primitive.replace("INPUT", input));
        lenient(&text).triangles
    };
    let square = vec![[0, 1, 2], [0, 2, 3]];
    assert_eq!(
        with("<triangles>INPUT<p>0 1 2 0 2 3</p></triangles>"),
        square
    );
    assert_eq!(
        with("<triangles count='0'>INPUT</triangles><trifans>INPUT<p>0 1 2 3</p></trifans>"),
        square
    );
    assert_eq!(
        with("<polygons>INPUT<p>0 1 2 3</p><ph><p>3 2 1</p><h>0 1 2</h></ph></polygons>"),
        [[0, 1, 2], [0, 2, 3], [3, 2, 1]]
    );
    assert_eq!(
        with("<tristrips>INPUT<p>0 1 3 2</p></tristrips>"),
        [[0, 1, 3], [3, 1, 2]]
    );
    // Two primitives share the positions.
    assert_eq!(
        with("<triangles>INPUT<p>0 1 2</p></triangles><triangles>INPUT<p>0 2 3</p></triangles>"),
        square
    );
}

#[test]
fn skins_stand_in_their_bind_pose() {
    let text = SQUARE
        .replace("<library_visual_scenes>", r##"<library_controllers><controller id="c"><skin source="#a b">
            <bind_shape_matrix>1 0 0 0 0 1 0 0 0 0 1 7 0 0 0 1</bind_shape_matrix></skin></controller></library_controllers>
            <library_visual_scenes>"##)
        .replace("<instance_geometry url=\"#a b\"/>\n</node>", "<instance_controller url=\"#c\"/>\n</node>");
    assert!((lenient(&text).vertices[0] - DVec3::new(1.0, 0.0, 0.07)).length() < 1e-12);
}

#[test]
fn broken_files_name_the_element() {
    for (from, to, words) in [
        (
            "9 3</p>",
            "9 4</p>",
            vec!["index 4", "4 vertices", "<polylist>", "'a b'"],
        ),
        ("9 3</p>", "9 -3</p>", vec!["'-3'"]),
        ("9 3</p>", "9</p>", vec!["groups of 2"]),
        ("<vcount>4<", "<vcount>5<", vec!["shorter"]),
        ("<vcount>4<", "<vcount>-4<", vec!["'-4'"]),
        (
            "0 2 0</float",
            "0 2 nan</float",
            vec!["<float_array>", "not finite"],
        ),
        ("0 2 0</float", "0 2</float", vec!["count=\"4\"", "3"]),
        ("stride=\"3\"", "stride=\"0\"", vec!["stride"]),
        (
            "count=\"4\" offset",
            "count=\"18446744073709551615\" offset",
            vec!["18446744073709551615"],
        ),
        ("1 0 0 100", "1 0 0", vec!["<matrix>", "15"]),
        ("1 0 0 100", "1 0 0 1e400", vec!["not finite"]),
        (
            "<instance_geometry url=\"#a b\"/>",
            "<instance_geometry url=\"#a\"/>",
            vec!["no geometry"],
        ),
        ("meter=\"0.01\"", "meter=\"-1\"", vec!["meter=\"-1\""]),
        ("</COLLADA>", "", vec!["never closed"]),
    ] {
        assert!(SQUARE.contains(from), "{from}");
        let error = read_text(&SQUARE.replace(from, to), &LoadOptions::default()).unwrap_err();
        let error = error.to_string();
        for word in words {
            assert!(error.contains(word), "{error}");
        }
    }
}

#[test]
fn instancing_does_not_exceed_the_limit() {
    let few = LoadOptions {
        max_triangles: 3,
        ..LoadOptions::default()
    };
    let twice = "<instance_geometry url=\"#a b\"/><instance_geometry url=\"#a b\"/>";
    let text = SQUARE.replace("<instance_geometry url=\"#a b\"/>", twice);
    assert!(read_text(SQUARE, &few).is_ok());
    assert!(read_text(&text, &few).is_err());
}

//! glTF files that are refused, and what is said of them.

use serde_json::json;

use super::{File, grey};

/// What is done to a sound file, and what is then said of it.
type Case = (fn(&mut File), &'static str);

/// Two keys of a rotation that does not turn.
const STILL: [f32; 8] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

/// Animations, skins and targets that cannot be.
const BAD_MOVERS: [Case; 11] = [
    (
        |file| {
            file.animation("rotation", "VEC3", &STILL[..6]);
        },
        "is of type Vec3 of F32; allowed are [Vec4] of [F32, I8, U8, I16, U16]",
    ),
    (
        |file| {
            let [input, _] = file.animation("rotation", "VEC4", &STILL);
            file.json["accessors"][input]["componentType"] = json!(5121);
        },
        "is of type Scalar of U8; allowed are [Scalar] of [F32]",
    ),
    (
        |file| {
            let [_, output] = file.animation("rotation", "VEC4", &STILL);
            file.json["accessors"][output]["count"] = json!(0);
        },
        "`output` (accessor 10) is empty",
    ),
    (
        |file| {
            file.animation("rotation", "VEC4", &[0.0; 8]);
        },
        "a rotation has no length",
    ),
    (
        |file| {
            file.attribute("JOINTS_0", "VEC4", &[0.0; 12]);
        },
        "is of type Vec4 of F32; allowed are [Vec4] of [U8, U16]",
    ),
    (
        |file| {
            let [_, weights, _] = file.skin();
            file.json["accessors"][weights]["componentType"] = json!(5125);
        },
        "is of type Vec4 of U32; allowed are [Vec4] of [F32, U8, U16]",
    ),
    (
        |file| {
            let [joints, ..] = file.skin();
            file.json["accessors"][joints]["count"] = json!(2);
        },
        "`JOINTS_0` has 2 values for 3 positions",
    ),
    (
        |file| {
            let [_, _, bind] = file.skin();
            file.json["accessors"][bind]["count"] = json!(0);
        },
        "is empty",
    ),
    (
        |file| {
            let primitive = &mut file.json["meshes"][0]["primitives"][0];
            primitive["attributes"].as_object_mut().unwrap().remove("WEIGHTS_0");
        },
        "a skinned primitive has no `WEIGHTS_0`",
    ),
    (
        |file| {
            let target = file.accessor("VEC3", &[0.0; 6]);
            file.json["accessors"][target]["min"] = json!([0.0, 0.0, 0.0]);
            file.json["accessors"][target]["max"] = json!([0.0, 0.0, 0.0]);
            file.json["meshes"][0]["primitives"][0]["targets"] = json!([{"POSITION": target}]);
        },
        "`POSITION of a target` has 2 values for 3 positions",
    ),
    (
        |file| file.keys = "animation = { clip = \"walk\" }",
        "object `thing`, `animation`: ",
    ),
];

#[test]
fn an_extension_that_is_required_and_unknown_is_named() {
    let mut file = File::new();
    file.json["extensionsRequired"] = json!(["KHR_materials_anisotropy"]);
    let message = file.error();
    assert!(
        message.contains("requires the extension `KHR_materials_anisotropy`; known are"),
        "{message}"
    );
}

#[test]
fn a_missing_or_broken_picture_is_named_with_its_node_and_material() {
    let mut file = File::new();
    file.picture("lost.png", &grey(2));
    file.material(json!({"name": "paint", "emissiveTexture": {"index": 0}}));
    for (contents, expected) in [(None, "lost.png"), (Some("no picture"), "lost.png")] {
        let path = file.folder.path().join("lost.png");
        match contents {
            Some(text) => std::fs::write(path, text).unwrap(),
            None => std::fs::remove_file(path).unwrap(),
        }
        let message = file.error();
        for part in ["node `blade`", "material `paint`", expected] {
            assert!(message.contains(part), "{message}");
        }
    }
    file.material(json!({"emissiveTexture": {"index": 7}}));
    let message = file.error();
    assert!(message.contains("emissiveTexture.index"), "{message}");
    file.material(json!({"extensions": {"KHR_materials_clearcoat": {"clearcoatTexture": {"index": 7}}}}));
    let message = file.error();
    assert!(message.contains("there is no texture 7"), "{message}");
}

#[test]
fn a_picture_beyond_its_buffer_is_refused() {
    let mut file = File::new();
    let view = file.list("bufferViews", json!({"buffer": 0, "byteOffset": 8, "byteLength": 4000}));
    file.list("images", json!({"bufferView": view, "mimeType": "image/png"}));
    file.list("textures", json!({"source": 0}));
    file.material(json!({"emissiveTexture": {"index": 0}}));
    let message = file.error();
    assert!(message.contains("goes beyond its buffer"), "{message}");
}

#[test]
fn bad_attributes_are_named() {
    let change = |edit: fn(&mut File)| {
        let mut file = File::new();
        edit(&mut file);
        file.error()
    };
    for (message, expected) in [
        (
            change(|file| file.json["accessors"][2]["count"] = json!(2)),
            "`TEXCOORD_0` has 2 values for 3 positions",
        ),
        (
            change(|file| file.json["accessors"][2]["type"] = json!("VEC3")),
            "`TEXCOORD_0` (accessor 2) is of type Vec3",
        ),
        (
            change(|file| file.json["accessors"][2]["componentType"] = json!(5122)),
            "`TEXCOORD_0` (accessor 2) is of type Vec2 of I16; allowed are",
        ),
        (
            change(|file| file.json["accessors"][2]["byteOffset"] = json!(1_000_000)),
            "`TEXCOORD_0` (accessor 2) goes beyond its buffer",
        ),
        (
            change(|file| file.json["bufferViews"][2]["byteLength"] = json!(8)),
            "`TEXCOORD_0` (accessor 2) goes beyond its buffer",
        ),
        (
            change(|file| {
                file.attribute("TEXCOORD_0", "VEC2", &[f32::NAN; 6]);
            }),
            "vertex 0 has a normal, tangent, colour or texture coordinate that is not a finite number",
        ),
        (
            change(|file| {
                let picture = file.picture("grey.png", &grey(2));
                file.material(json!({"emissiveTexture": {"index": picture}}));
                let primitive = &mut file.json["meshes"][0]["primitives"][0];
                primitive["attributes"].as_object_mut().unwrap().remove("TEXCOORD_0");
            }),
            "a texture goes by `TEXCOORD_0`, which a primitive lacks",
        ),
        (
            change(|file| {
                let picture = file.picture("grey.png", &grey(2));
                file.material(json!({"emissiveTexture": {"index": picture, "texCoord": 2}}));
            }),
            "a texture goes by TEXCOORD_2; there may be 0 and 1",
        ),
        (
            change(|file| file.material(json!({"pbrMetallicRoughness": {"roughnessFactor": 1.5}}))),
            "`roughnessFactor` holds `1.5`; allowed are 0 ..= 1",
        ),
    ] {
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn bad_animations_skins_and_targets_are_named() {
    let sound = |edit: fn(&mut File)| {
        let mut file = File::new();
        file.animation("rotation", "VEC4", &STILL);
        file.skin();
        edit(&mut file);
        file
    };
    sound(|_| {}).load().unwrap();
    for (edit, expected) in BAD_MOVERS {
        let message = sound(edit).error();
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn files_that_are_valid_json_and_no_sound_gltf_are_refused() {
    let cases: [Case; 8] = [
        (
            |file| file.json["images"] = json!([{"bufferView": 0}]),
            "picture `0` lacks its source: a picture in a `bufferView` has a `mimeType`",
        ),
        (
            |file| file.json["images"] = json!([{"name": "photo"}]),
            "picture `photo` lacks its source: a picture has a `uri` or a `bufferView`",
        ),
        (
            |file| file.json["images"] = json!([{"uri": "%FF.png"}]),
            "the uri `%FF.png` is not UTF-8",
        ),
        (
            |file| file.json["buffers"][0]["uri"] = json!("%FF.bin"),
            "the uri `%FF.bin` is not UTF-8",
        ),
        (
            |file| file.json["nodes"][0]["children"] = json!([0]),
            "node `blade` is reached twice",
        ),
        (
            |file| {
                file.json["nodes"] =
                    json!([{"children": [1, 2]}, {"children": [3]}, {"children": [3]}, {"mesh": 0, "name": "leaf"}]);
            },
            "node `leaf` is reached twice",
        ),
        (
            |file| {
                let chain = (1..300).map(|child| json!({"children": [child]}));
                file.json["nodes"] = chain.chain([json!({"mesh": 0})]).collect();
            },
            "lies more than 256 levels deep",
        ),
        (
            |file| file.json["nodes"][0]["rotation"] = json!([0.0, 0.0, 0.0, 0.0]),
            "node `blade` has a rotation without length",
        ),
    ];
    for (edit, expected) in cases {
        let mut file = File::new();
        edit(&mut file);
        let message = file.error();
        assert!(message.contains(expected), "{message}");
    }
}

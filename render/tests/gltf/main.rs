//! glTF files as objects of a scene: materials and vertices.

#![expect(clippy::unwrap_used, reason = "tests may; this covers their own functions too")]

mod refused;
#[path = "../support/mod.rs"]
mod support;

use std::path::Path;

use glam::Vec3;
use mirrorball_render::scene::material::{Alpha, Model, Sides, UvSet, Wrap};
use mirrorball_render::scene::{Mesh, Scene};
use serde_json::{Value, json};

/// A file of one triangle, whose attributes lie one after the other in `mesh.bin`.
struct File {
    folder: tempfile::TempDir,
    json: Value,
    bytes: Vec<u8>,
    /// More keys of the object in the scene file.
    keys: &'static str,
}

impl File {
    /// A triangle with normals and both sets of texture coordinates, of material 0.
    fn new() -> Self {
        let mut file = Self {
            folder: tempfile::tempdir().unwrap(),
            json: json!({
                "asset": {"version": "2.0"},
                "scenes": [{"nodes": [0]}],
                "nodes": [{"mesh": 0, "name": "blade"}],
                "meshes": [{"primitives": [{"attributes": {}, "material": 0}]}],
                "materials": [{"name": "paint"}],
                "buffers": [{"uri": "mesh.bin", "byteLength": 0}],
                "bufferViews": [],
                "accessors": [],
            }),
            bytes: Vec::new(),
            keys: "",
        };
        file.attribute("POSITION", "VEC3", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        file.json["accessors"][0]["min"] = json!([0.0, 0.0, 0.0]);
        file.json["accessors"][0]["max"] = json!([1.0, 1.0, 0.0]);
        file.attribute("NORMAL", "VEC3", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
        file.attribute("TEXCOORD_0", "VEC2", &[0.0, 1.0, 1.0, 1.0, 0.0, 0.0]);
        file.attribute("TEXCOORD_1", "VEC2", &[0.5; 6]);
        file
    }

    fn list(&mut self, name: &str, item: Value) -> usize {
        let list = &mut self.json[name];
        if list.is_null() {
            *list = json!([]);
        }
        let list = list.as_array_mut().unwrap();
        list.push(item);
        list.len() - 1
    }

    fn view(&mut self, numbers: &[f32]) -> usize {
        let offset = self.bytes.len();
        self.bytes.extend(numbers.iter().flat_map(|n| n.to_le_bytes()));
        let view = json!({"buffer": 0, "byteOffset": offset, "byteLength": 4 * numbers.len()});
        self.list("bufferViews", view)
    }

    /// Returns the accessor of these numbers.
    fn accessor(&mut self, kind: &str, numbers: &[f32]) -> usize {
        let view = self.view(numbers);
        let width = match kind {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            "MAT4" => 16,
            other => panic!("{other}"),
        };
        let count = numbers.len() / width;
        self.list(
            "accessors",
            json!({"bufferView": view, "componentType": 5126, "count": count, "type": kind}),
        )
    }

    /// An attribute of the vertices; returns its accessor.
    fn attribute(&mut self, name: &str, kind: &str, numbers: &[f32]) -> usize {
        let accessor = self.accessor(kind, numbers);
        self.json["meshes"][0]["primitives"][0]["attributes"][name] = json!(accessor);
        accessor
    }

    /// A picture beside the file; returns the index of its texture.
    fn picture(&mut self, name: &str, image: &image::DynamicImage) -> usize {
        image.save(self.folder.path().join(name)).unwrap();
        let image = self.list("images", json!({"uri": name}));
        self.list("textures", json!({"source": image}))
    }

    /// An animation of the node, with keys at 0 and 1 s, that is played; returns the accessors of its times and values.
    fn animation(&mut self, path: &str, kind: &str, values: &[f32]) -> [usize; 2] {
        let input = self.accessor("SCALAR", &[0.0, 1.0]);
        self.json["accessors"][input]["min"] = json!([0.0]);
        self.json["accessors"][input]["max"] = json!([1.0]);
        let output = self.accessor(kind, values);
        self.json["animations"] = json!([{
            "name": "turn",
            "samplers": [{"input": input, "output": output}],
            "channels": [{"sampler": 0, "target": {"node": 0, "path": path}}],
        }]);
        self.keys = "animation = { clip = 0 }";
        [input, output]
    }

    /// Hangs the vertices on the node itself; returns the accessors of joints, weights and the inverse bind matrix.
    fn skin(&mut self) -> [usize; 3] {
        self.bytes.extend([0; 12]);
        let offset = self.bytes.len() - 12;
        let view = self.list(
            "bufferViews",
            json!({"buffer": 0, "byteOffset": offset, "byteLength": 12}),
        );
        let joints = self.list(
            "accessors",
            json!({"bufferView": view, "componentType": 5121, "count": 3, "type": "VEC4"}),
        );
        self.json["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"] = json!(joints);
        let weights = self.attribute("WEIGHTS_0", "VEC4", &[1.0, 0.0, 0.0, 0.0].repeat(3));
        let bind = self.accessor("MAT4", &glam::Mat4::IDENTITY.to_cols_array());
        self.json["skins"] = json!([{"joints": [0], "inverseBindMatrices": bind}]);
        self.json["nodes"][0]["skin"] = json!(0);
        [joints, weights, bind]
    }

    fn material(&mut self, json: Value) {
        self.json["materials"][0] = json;
    }

    fn load(&self) -> Result<Mesh, String> {
        let at = |name: &str| self.folder.path().join(name);
        let mut json = self.json.clone();
        json["buffers"][0]["byteLength"] = json!(self.bytes.len());
        std::fs::write(at("mesh.bin"), &self.bytes).unwrap();
        std::fs::write(at("thing.gltf"), json.to_string()).unwrap();
        let scene = format!(
            "version = 1\n[[object]]\nname = \"thing\"\nkind = \"virtual\"\nmesh = \"thing.gltf\"\nmesh_up = \"z\"\n{}\n",
            self.keys
        );
        std::fs::write(at("scene.toml"), scene).unwrap();
        load(&at("scene.toml"))
    }

    fn error(&self) -> String {
        let message = self.load().unwrap_err();
        assert!(message.contains("thing.gltf"), "the file is not named: {message}");
        message
    }
}

fn load(scene: &Path) -> Result<Mesh, String> {
    match Scene::load(scene, &support::rig()) {
        Ok(mut scene) => Ok(scene.objects.remove(0).mesh),
        Err(error) => Err(error.to_string()),
    }
}

fn grey(edge: u32) -> image::DynamicImage {
    image::DynamicImage::ImageLuma8(image::GrayImage::from_pixel(edge, edge, image::Luma([128])))
}

/// A material that says all it can with three textures.
fn everything([grey, deep, photo]: [usize; 3]) -> Value {
    json!({
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.5, 0.6, 0.7, 0.8],
            "baseColorTexture": {"index": photo, "texCoord": 1},
            "metallicFactor": 0.3,
            "roughnessFactor": 0.4,
            "metallicRoughnessTexture": {"index": deep, "extensions": {"KHR_texture_transform": {"offset": [0.1, 0.2]}}},
        },
        "normalTexture": {"index": grey, "scale": 0.5},
        "occlusionTexture": {"index": grey, "strength": 0.25},
        "emissiveFactor": [1.0, 0.5, 0.0],
        "emissiveTexture": {"index": grey},
        "alphaMode": "MASK",
        "alphaCutoff": 0.3,
        "doubleSided": true,
        "extensions": {
            "KHR_materials_emissive_strength": {"emissiveStrength": 4.0},
            "KHR_materials_clearcoat": {"clearcoatFactor": 0.9, "clearcoatRoughnessFactor": 0.2, "clearcoatTexture": {"index": grey}},
            "KHR_materials_sheen": {"sheenColorFactor": [0.1, 0.2, 0.3], "sheenRoughnessFactor": 0.6},
            "KHR_materials_ior": {"ior": 2.0},
            "KHR_materials_specular": {"specularFactor": 0.5, "specularColorFactor": [1.0, 2.0, 0.0]},
            "KHR_materials_transmission": {"transmissionFactor": 0.7},
            "KHR_materials_volume": {"thicknessFactor": 0.01, "attenuationDistance": 0.1, "attenuationColor": [0.9, 0.8, 0.7]},
        },
    })
}

#[test]
fn a_material_with_everything_is_read() {
    let mut file = File::new();
    let grey = file.picture("grey.png", &grey(4));
    let deep = image::ImageBuffer::from_pixel(2, 2, image::Rgba([65535u16, 32768, 0, 65535]));
    let deep = file.picture("deep.png", &image::DynamicImage::ImageRgba16(deep));
    let photo = image::RgbImage::from_pixel(8, 8, image::Rgb([200, 100, 50]));
    let photo = file.picture("photo.jpg", &image::DynamicImage::ImageRgb8(photo));
    file.json["samplers"] = json!([{"wrapS": 33071, "wrapT": 33648}]);
    file.json["textures"][photo]["sampler"] = json!(0);
    file.json["extensionsRequired"] = json!(["KHR_materials_clearcoat", "KHR_texture_transform"]);
    file.material(everything([grey, deep, photo]));
    let mesh = file.load().unwrap();
    let [material] = &mesh.materials[..] else {
        panic!("one material")
    };
    assert_eq!((material.base_color, material.opacity), ([0.5, 0.6, 0.7], 0.8));
    let base = material.base_color_texture.as_ref().unwrap();
    assert_eq!((base.uv_set, base.wrap), (UvSet::Second, [Wrap::Clamp, Wrap::Mirror]));
    assert!(
        base.image
            .rgba
            .chunks_exact(4)
            .all(|p| p[3] == 255 && p[0].abs_diff(200) < 5)
    );
    assert_eq!((material.metallic, material.roughness), (0.3, 0.4));
    let deep = material.metallic_roughness_texture.as_ref().unwrap();
    assert_eq!(deep.image.rgba[..4], [255, 128, 0, 255]);
    assert_eq!(deep.picture_from_uv.translation.to_array(), [0.1, 0.2]);
    assert_eq!(material.normal.as_ref().unwrap().scale, 0.5);
    assert_eq!(material.occlusion_strength, 0.25);
    assert!(material.occlusion_texture.is_some() && material.emission_texture.is_some());
    assert_eq!(material.emission, [4.0, 2.0, 0.0]);
    assert_eq!(material.alpha, Alpha::Mask { cutoff: 0.3 });
    assert_eq!(
        (material.sides, material.model),
        (Sides::Both, Model::MetallicRoughness)
    );
    assert_eq!((material.clearcoat.factor, material.clearcoat.roughness), (0.9, 0.2));
    assert_eq!((material.sheen.color, material.sheen.roughness), ([0.1, 0.2, 0.3], 0.6));
    let f0 = 1.0 / 9.0;
    let expected = Vec3::new(0.5 * f0, f0, 0.0);
    assert!(
        Vec3::from(material.dielectric_f0).distance(expected) < 1e-6,
        "{:?}",
        material.dielectric_f0
    );
    assert_eq!(
        (material.dielectric_f90, material.transmission, material.ior),
        (0.5, 0.7, 2.0)
    );
    assert_eq!(material.volume.attenuation_distance_m, 0.1);
    // The grey picture is held once for all that show it.
    let [one, other] = [&material.occlusion_texture, &material.emission_texture].map(|t| t.as_ref().unwrap());
    assert!(std::sync::Arc::ptr_eq(&one.image, &other.image));
}

#[test]
fn vertices_are_read_and_completed() {
    let mut file = File::new();
    let normal = file.picture("normal.png", &grey(2));
    file.material(json!({"normalTexture": {"index": normal}}));
    file.attribute("COLOR_0", "VEC3", &[0.5; 9]);
    let mesh = file.load().unwrap();
    assert_eq!(mesh.vertices[0].tangent, [1.0, 0.0, 0.0, 1.0]);
    assert_eq!(mesh.vertices[1].uv, [1.0, 1.0]);
    assert_eq!(mesh.vertices[1].uv1, [0.5, 0.5]);
    assert_eq!(mesh.vertices[2].color, [0.5, 0.5, 0.5, 1.0]);
    file.attribute(
        "TANGENT",
        "VEC4",
        &[0.0, 2.0, 0.0, -1.0, 0.0, 2.0, 0.0, -1.0, 0.0, 2.0, 0.0, -1.0],
    );
    assert_eq!(file.load().unwrap().vertices[0].tangent, [0.0, 1.0, 0.0, -1.0]);
    // A node that mirrors turns neither the front nor the picture over.
    file.json["nodes"][0]["scale"] = json!([-1.0, 1.0, 1.0]);
    let mirrored = file.load().unwrap();
    let place = |k: usize| Vec3::from(mirrored.vertices[mirrored.indices[k] as usize].position);
    assert_eq!((place(1) - place(0)).cross(place(2) - place(0)), Vec3::Z);
    assert_eq!(mirrored.vertices[0].tangent, [0.0, 1.0, 0.0, 1.0]);
}

#[test]
fn normals_without_length_are_those_of_the_face() {
    let mut file = File::new();
    file.attribute("NORMAL", "VEC3", &[0.0; 9]);
    assert!(
        file.load()
            .unwrap()
            .vertices
            .iter()
            .all(|v| v.normal == [0.0, 0.0, 1.0])
    );
}

#[test]
fn triangles_that_run_against_their_normals_are_seen_from_both_sides() {
    let mut file = File::new();
    assert_eq!(file.load().unwrap().materials[0].sides, Sides::Front);
    file.attribute("NORMAL", "VEC3", &[0.0, 0.0, -1.0, 0.0, 0.0, -1.0, 0.0, 0.0, -1.0]);
    assert_eq!(file.load().unwrap().materials[0].sides, Sides::Both);
}

#[test]
fn texture_coordinates_without_area_give_finite_tangents() {
    let mut file = File::new();
    let normal = file.picture("normal.png", &grey(2));
    file.material(json!({"normalTexture": {"index": normal, "texCoord": 1}}));
    for vertex in file.load().unwrap().vertices {
        let along = Vec3::from_slice(&vertex.tangent[..3]);
        assert!((along.length() - 1.0).abs() < 1e-5 && along.z.abs() < 1e-5, "{along}");
    }
}

#[test]
fn sparse_accessors_are_read() {
    let mut file = File::new();
    let values = file.view(&[0.25, 0.75]);
    let offset = file.bytes.len();
    file.bytes.extend([2, 0, 0, 0]);
    let indices = file.list(
        "bufferViews",
        json!({"buffer": 0, "byteOffset": offset, "byteLength": 1}),
    );
    file.json["accessors"][2]["sparse"] = json!({
        "count": 1,
        "indices": {"bufferView": indices, "componentType": 5121},
        "values": {"bufferView": values},
    });
    let mesh = file.load().unwrap();
    assert_eq!(mesh.vertices[1].uv, [1.0, 1.0]);
    assert_eq!(mesh.vertices[2].uv, [0.25, 0.75]);
}

#[test]
fn the_seed_material_comes_from_extras() {
    let mut file = File::new();
    file.material(json!({"extras": {"mirrorball_gloss_in_alpha": true}}));
    assert_eq!(file.load().unwrap().materials[0].model, Model::GlossInAlpha);
}

#[test]
fn a_small_node_is_no_flat_one() {
    let mut file = File::new();
    file.json["nodes"][0]["scale"] = json!([1e-5, 1e-5, 1e-5]);
    file.keys = "scale = 1e5";
    let mesh = file.load().unwrap();
    assert!(Vec3::from(mesh.vertices[1].position).distance(Vec3::X) < 1e-5);
    file.json["nodes"][0]["scale"] = json!([1.0, 1.0, 0.0]);
    let message = file.error();
    assert!(message.contains("flattens it"), "{message}");
}

#[test]
fn vertices_that_a_normal_map_splits_move_with_those_that_they_come_from() {
    let mut file = File::new();
    let normal = file.picture("normal.png", &grey(2));
    file.material(json!({"normalTexture": {"index": normal}}));
    let places = [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 1.0, 0.0, 0.0];
    let position = file.attribute("POSITION", "VEC3", &places);
    file.json["accessors"][position]["min"] = json!([-1.0, 0.0, 0.0]);
    file.json["accessors"][position]["max"] = json!([1.0, 1.0, 0.0]);
    file.attribute("NORMAL", "VEC3", &[0.0, 0.0, 1.0].repeat(4));
    file.attribute("TEXCOORD_0", "VEC2", &[0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]);
    file.attribute("TEXCOORD_1", "VEC2", &[0.5; 8]);
    let offset = file.bytes.len();
    file.bytes.extend([0, 3, 1, 0, 1, 2, 0, 0]);
    let view = file.list(
        "bufferViews",
        json!({"buffer": 0, "byteOffset": offset, "byteLength": 6}),
    );
    let indices = json!({"bufferView": view, "componentType": 5121, "count": 6, "type": "SCALAR"});
    file.json["meshes"][0]["primitives"][0]["indices"] = json!(file.list("accessors", indices));
    // A target that lifts the second vertex, one of the two that are split.
    let lifted = [0.0, 0.0, 0.0, 0.0, 0.0, 0.25, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let target = file.accessor("VEC3", &lifted);
    file.json["accessors"][target]["min"] = json!([0.0, 0.0, 0.0]);
    file.json["accessors"][target]["max"] = json!([0.0, 0.0, 0.25]);
    file.json["meshes"][0]["primitives"][0]["targets"] = json!([{"POSITION": target}]);
    file.json["meshes"][0]["weights"] = json!([1.0]);
    // Three turned nodes above each other: products of their matrices round differently by the order.
    let turned = json!([0.5, 0.5, -0.5, 0.5]);
    file.json["nodes"] = json!([
        {"children": [1], "rotation": [0.3, 0.2, 0.1, 0.927_361_85], "translation": [0.01, 0.02, 0.03]},
        {"children": [2], "rotation": [0.1, 0.7, 0.1, 0.7], "scale": [1.1, 1.1, 1.1]},
        {"mesh": 0, "name": "blade", "rotation": turned, "translation": [0.003, 0.0041, 0.0057]},
    ]);
    let mesh = file.load().unwrap();
    assert_eq!(mesh.vertices.len(), 6);
    for (twin, origin) in [(4, 0), (5, 1)] {
        assert_eq!(mesh.vertices[twin].position, mesh.vertices[origin].position);
    }
    let lift = Vec3::from(mesh.vertices[5].position).distance(Vec3::from(mesh.vertices[4].position));
    assert!((lift - 1.1 * 1.0625f32.sqrt()).abs() < 1e-4, "{lift}");
}

#[test]
fn pictures_of_any_size_and_number_fit_or_are_refused() {
    use mirrorball_render::scene::Material;
    use mirrorball_render::scene::material::{Image, Texture};
    use mirrorball_render::scene_materials::SceneMaterials;
    let Some(gpu) = support::gpu() else { return };
    let shows = |size_px: [u32; 2]| {
        let image = Image {
            name: "picture".into(),
            size_px,
            rgba: vec![128; 4 * (size_px[0] * size_px[1]) as usize],
        };
        Material {
            base_color_texture: Some(Texture::plain(std::sync::Arc::new(image))),
            ..Material::default()
        }
    };
    // Wider than any adapter's texture.
    SceneMaterials::new(&gpu, &[shows([40_000, 3]), shows([1, 1])]).unwrap();
    gpu.wait("uploading pictures").unwrap();
    let most = gpu.device.limits().max_texture_array_layers as usize;
    // The same picture many times is one.
    SceneMaterials::new(&gpu, &vec![shows([1, 1]); most + 1]).unwrap();
    let many: Vec<Material> = (0..=most).map(|_| shows([1, 1])).collect();
    let error = SceneMaterials::new(&gpu, &many).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("a number of pictures of materials"), "{error}");
}

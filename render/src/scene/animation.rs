//! Animations of glTF 2.0 (section 3.11): how the nodes of a file move, and the weights of its morph targets.

use glam::{Mat4, Quat, Vec3};
use gltf::accessor::{DataType, Dimensions};
use gltf::animation::util::ReadOutputs;
use gltf::animation::{Interpolation, Property};

use super::entry::listed;
use super::gltf_check;

/// The nodes of a file, as they rest.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Skeleton {
    /// By the file's own index.
    rest: Vec<Rest>,
    /// Nodes of the scene, parents before children.
    order: Vec<(usize, Option<usize>)>,
}

/// How a node stands in its parent.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Rest {
    translation: Vec3,
    rotation: Quat,
    scale: Vec3,
}

/// An animation of a file.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Clip {
    channels: Vec<Channel>,
    duration_s: f32,
}

#[derive(Debug, Clone, PartialEq)]
struct Channel {
    node: usize,
    part: Part,
    curve: Curve,
}

/// What of a node a channel changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Part {
    Translation,
    Rotation,
    Scale,
    Weights,
}

/// Numbers over time.
#[derive(Debug, Clone, PartialEq)]
struct Curve {
    times_s: Vec<f32>,
    /// `width` per key; with cubic splines three times as many: tangent in, value, tangent out.
    values: Vec<f32>,
    width: usize,
    interpolation: Interpolation,
}

/// Which animation of a file is meant.
#[derive(Debug, Clone, PartialEq, Eq, serde::Deserialize)]
#[serde(untagged, expecting = "the animation's name or its number from 0")]
pub(super) enum ClipName {
    /// By its number in the file.
    Index(usize),
    /// By its name.
    Name(String),
}

impl Skeleton {
    pub(super) fn read(document: &gltf::Document, scene: Option<&gltf::Scene<'_>>) -> Self {
        let rest = |node: gltf::Node<'_>| {
            let (translation, rotation, scale) = node.transform().decomposed();
            Rest {
                translation: translation.into(),
                rotation: Quat::from_array(rotation).normalize(),
                scale: scale.into(),
            }
        };
        let mut order = Vec::new();
        let mut waiting: Vec<_> = scene
            .into_iter()
            .flat_map(gltf::Scene::nodes)
            .map(|n| (n, None))
            .collect();
        while let Some((node, parent)) = waiting.pop() {
            let index = node.index();
            waiting.extend(node.children().map(|child| (child, Some(index))));
            order.push((index, parent));
        }
        Self {
            rest: document.nodes().map(rest).collect(),
            order,
        }
    }

    /// File from node for every node of the file, `clip` played up to `time_s`; nodes outside the scene stay at the origin.
    pub(super) fn file_from_nodes(&self, clip: Option<&Clip>, time_s: f32) -> Vec<Mat4> {
        let mut local = self.rest.clone();
        for channel in clip.iter().flat_map(|clip| &clip.channels) {
            let mut value = [0.0; 4];
            match channel.part {
                Part::Translation => {
                    channel.curve.sample(time_s, &mut value[..3]);
                    local[channel.node].translation = Vec3::from_slice(&value);
                }
                Part::Rotation => local[channel.node].rotation = channel.curve.rotation(time_s),
                Part::Scale => {
                    channel.curve.sample(time_s, &mut value[..3]);
                    local[channel.node].scale = Vec3::from_slice(&value);
                }
                Part::Weights => {}
            }
        }
        let mut globals = vec![Mat4::IDENTITY; local.len()];
        for &(node, parent) in &self.order {
            let Rest {
                translation,
                rotation,
                scale,
            } = local[node];
            let parent_from_node = Mat4::from_scale_rotation_translation(scale, rotation, translation);
            globals[node] = parent.map_or(Mat4::IDENTITY, |parent| globals[parent]) * parent_from_node;
        }
        globals
    }
}

impl Clip {
    /// Reads the animation that is meant.
    ///
    /// # Errors
    /// An animation that the file lacks, and channels that do not hold what they should.
    pub(super) fn read(
        document: &gltf::Document,
        buffers: &[gltf::buffer::Data],
        name: &ClipName,
    ) -> Result<Self, String> {
        let channels = find(document, name)?
            .channels()
            .map(|channel| {
                let node = channel.target().node();
                let name = node.name().unwrap_or("(unnamed)").to_owned();
                read_channel(&channel, buffers).map_err(|message| format!("node `{name}`, animation: {message}"))
            })
            .collect::<Result<Vec<Channel>, String>>()?;
        let ends = channels.iter().filter_map(|channel| channel.curve.times_s.last());
        Ok(Self {
            duration_s: ends.copied().fold(0.0, f32::max),
            channels,
        })
    }

    /// Seconds from start to end.
    pub(super) fn duration_s(&self) -> f32 {
        self.duration_s
    }

    /// Sets the weights of a node's morph targets, if the animation changes them.
    pub(super) fn set_weights(&self, node: usize, time_s: f32, weights: &mut [f32]) {
        let of_node = |channel: &&Channel| channel.node == node && channel.part == Part::Weights;
        if let Some(channel) = self.channels.iter().find(of_node)
            && channel.curve.width == weights.len()
        {
            channel.curve.sample(time_s, weights);
        }
    }
}

/// The animation that is meant; the message names those that there are.
pub(super) fn find<'a>(document: &'a gltf::Document, name: &ClipName) -> Result<gltf::Animation<'a>, String> {
    let is_meant = |animation: &gltf::Animation<'_>| match name {
        ClipName::Index(index) => animation.index() == *index,
        ClipName::Name(name) => animation.name() == Some(name),
    };
    document.animations().find(is_meant).ok_or_else(|| {
        let names = document
            .animations()
            .map(|a| a.name().map_or_else(|| a.index().to_string(), str::to_owned));
        let wanted = match name {
            ClipName::Index(index) => index.to_string(),
            ClipName::Name(name) => name.clone(),
        };
        format!("it has no animation `{wanted}`; its animations are {}", listed(names))
    })
}

fn read_channel(channel: &gltf::animation::Channel<'_>, buffers: &[gltf::buffer::Data]) -> Result<Channel, String> {
    check_sampler(channel, buffers)?;
    let reader = channel.reader(|buffer| buffers.get(buffer.index()).map(|data| &data.0[..]));
    let times_s: Vec<f32> = reader.read_inputs().ok_or("it has no times")?.collect();
    let values: Vec<f32> = match reader.read_outputs().ok_or("it has no values")? {
        ReadOutputs::Translations(values) | ReadOutputs::Scales(values) => values.flatten().collect(),
        ReadOutputs::Rotations(values) => values.into_f32().flatten().collect(),
        ReadOutputs::MorphTargetWeights(values) => values.into_f32().collect(),
    };
    let interpolation = channel.sampler().interpolation();
    let per_value = match interpolation {
        Interpolation::Linear | Interpolation::Step => 1,
        Interpolation::CubicSpline => 3,
    };
    let (part, width) = match channel.target().property() {
        Property::Translation => (Part::Translation, 3),
        Property::Rotation => (Part::Rotation, 4),
        Property::Scale => (Part::Scale, 3),
        Property::MorphTargetWeights => (Part::Weights, values.len() / (per_value * times_s.len().max(1))),
    };
    let rises = times_s.windows(2).all(|pair| pair[0] < pair[1]);
    if times_s.is_empty() || !rises || times_s.iter().any(|t| !t.is_finite()) {
        return Err("its times are none, not finite or do not rise".into());
    }
    if values.len() != per_value * width * times_s.len() {
        return Err(format!("{} numbers for {} times", values.len(), times_s.len()));
    }
    if values.iter().any(|value| !value.is_finite()) {
        return Err("a value is not a finite number".into());
    }
    // Of a cubic spline's three only the second is a rotation.
    let mut keys = values.chunks_exact(width.max(1)).skip(per_value / 2).step_by(per_value);
    if part == Part::Rotation && keys.any(|key| Quat::from_slice(key).length() < gltf_check::MIN_ROTATION) {
        return Err("a rotation has no length".into());
    }
    Ok(Channel {
        node: channel.target().node().index(),
        part,
        curve: Curve {
            times_s,
            values,
            width,
            interpolation,
        },
    })
}

/// What the reader takes for granted: numbers of the types that glTF allows (2.0, 3.11), within their buffers.
fn check_sampler(channel: &gltf::animation::Channel<'_>, buffers: &[gltf::buffer::Data]) -> Result<(), String> {
    use DataType::{F32, I8, I16, U8, U16};
    use Dimensions::{Scalar, Vec3, Vec4};
    let sampler = channel.sampler();
    gltf_check::accessor("input", &sampler.input(), (&[Scalar], &[F32]), buffers)?;
    let normalized = &[F32, I8, U8, I16, U16][..];
    let allowed: (&[Dimensions], &[DataType]) = match channel.target().property() {
        Property::Translation | Property::Scale => (&[Vec3], &[F32]),
        Property::Rotation => (&[Vec4], normalized),
        Property::MorphTargetWeights => (&[Scalar], normalized),
    };
    gltf_check::accessor("output", &sampler.output(), allowed, buffers)
}

impl Curve {
    /// The key at or before a time, and how far it is to the next, 0 to 1; the ends hold beyond themselves.
    fn place(&self, time_s: f32) -> (usize, f32) {
        let next = self.times_s.partition_point(|&t| t <= time_s);
        if next == 0 {
            return (0, 0.0);
        }
        if next == self.times_s.len() {
            return (next - 1, 0.0);
        }
        let (from, to) = (self.times_s[next - 1], self.times_s[next]);
        (next - 1, (time_s - from) / (to - from))
    }

    /// Numbers of key `key`: of the value, or of a cubic spline's tangents on either side of it (`slot` 0 and 2).
    fn numbers(&self, key: usize, slot: usize) -> &[f32] {
        let start = match self.interpolation {
            Interpolation::Linear | Interpolation::Step => key * self.width,
            Interpolation::CubicSpline => (3 * key + slot) * self.width,
        };
        &self.values[start..start + self.width]
    }

    /// The value at a time (glTF 2.0, appendix C.2, C.3 and C.5).
    fn sample(&self, time_s: f32, out: &mut [f32]) {
        let (key, t) = self.place(time_s);
        let from = self.numbers(key, 1);
        if t == 0.0 || self.interpolation == Interpolation::Step {
            out.copy_from_slice(from);
            return;
        }
        let to = self.numbers(key + 1, 1);
        if self.interpolation == Interpolation::Linear {
            for ((out, from), to) in out.iter_mut().zip(from).zip(to) {
                *out = from + t * (to - from);
            }
            return;
        }
        let span_s = self.times_s[key + 1] - self.times_s[key];
        let (leaving, arriving) = (self.numbers(key, 2), self.numbers(key + 1, 0));
        let (t2, t3) = (t * t, t * t * t);
        for (i, out) in out.iter_mut().enumerate() {
            *out = (2.0 * t3 - 3.0 * t2 + 1.0) * from[i]
                + span_s * (t3 - 2.0 * t2 + t) * leaving[i]
                + (3.0 * t2 - 2.0 * t3) * to[i]
                + span_s * (t3 - t2) * arriving[i];
        }
    }

    /// The value at a time as a rotation: between two keys along the shortest way (appendix C.4).
    fn rotation(&self, time_s: f32) -> Quat {
        let (key, t) = self.place(time_s);
        if self.interpolation == Interpolation::Linear && t > 0.0 {
            let of = |key| Quat::from_slice(self.numbers(key, 1)).normalize();
            return of(key).slerp(of(key + 1), t);
        }
        let mut value = [0.0; 4];
        self.sample(time_s, &mut value);
        Quat::from_array(value).normalize()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(interpolation: Interpolation, values: &[f32], width: usize) -> Curve {
        Curve {
            times_s: vec![1.0, 3.0],
            values: values.to_vec(),
            width,
            interpolation,
        }
    }

    fn at(curve: &Curve, time_s: f32) -> f32 {
        let mut out = [0.0];
        curve.sample(time_s, &mut out);
        out[0]
    }

    #[test]
    fn straight_lines_and_steps_pass_through_their_keys() {
        let line = curve(Interpolation::Linear, &[2.0, 6.0], 1);
        assert_eq!(
            [0.0, 1.0, 1.5, 2.0, 3.0, 9.0].map(|t| at(&line, t)),
            [2.0, 2.0, 3.0, 4.0, 6.0, 6.0]
        );
        let step = curve(Interpolation::Step, &[2.0, 6.0], 1);
        assert_eq!([0.0, 2.9, 3.0].map(|t| at(&step, t)), [2.0, 2.0, 6.0]);
    }

    #[test]
    fn a_cubic_spline_is_the_polynomial_that_its_tangents_ask_for() {
        // x³ between 1 and 3, slope 3 x².
        let cube = curve(Interpolation::CubicSpline, &[3.0, 1.0, 3.0, 27.0, 27.0, 27.0], 1);
        for t in [1.0f32, 1.25, 2.0, 2.75, 3.0] {
            assert!((at(&cube, t) - t.powi(3)).abs() < 1e-5, "{t}: {}", at(&cube, t));
        }
    }

    #[test]
    fn rotations_go_the_short_way_at_an_even_pace() {
        let (from, to) = (Quat::from_rotation_z(0.2), -Quat::from_rotation_z(1.2));
        let values: Vec<f32> = [from.to_array(), to.to_array()].concat();
        let turn = curve(Interpolation::Linear, &values, 4);
        let expected = Quat::from_rotation_z(0.45);
        assert!(
            turn.rotation(1.5).dot(expected).abs() > 1.0 - 1e-6,
            "{}",
            turn.rotation(1.5)
        );
    }
}

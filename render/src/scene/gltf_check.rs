//! What reading a glTF file takes for granted and the `gltf` crate does not check, where it would stop the program.

use std::borrow::Cow;
use std::collections::HashSet;

use gltf::accessor::{Accessor, DataType, Dimensions};
use gltf::json::{Node, Root};

/// Deepest nesting of nodes that is read.
const MAX_DEPTH: usize = 256;

/// Shortest quaternion that is a rotation.
pub(super) const MIN_ROTATION: f32 = 1e-6;

/// Checks a file that is valid as JSON and in its indices.
///
/// # Errors
/// A file name that cannot be decoded, a picture without source or type, nodes that form no trees, a rotation without length.
pub(super) fn document(root: &Root) -> Result<(), String> {
    let buffers = root.buffers.iter().filter_map(|buffer| buffer.uri.as_deref());
    let images = root.images.iter().filter_map(|image| image.uri.as_deref());
    if let Some(uri) = buffers.chain(images).find(|uri| decoded(uri).is_none()) {
        return Err(format!("the uri `{uri}` is not UTF-8 once it is decoded"));
    }
    for (index, image) in root.images.iter().enumerate() {
        let wanted = match (&image.buffer_view, &image.mime_type, &image.uri) {
            (Some(_), None, _) => "a picture in a `bufferView` has a `mimeType`",
            (None, _, None) => "a picture has a `uri` or a `bufferView`",
            (Some(_), Some(_), _) | (None, _, Some(_)) => continue,
        };
        let name = image.name.clone().unwrap_or_else(|| index.to_string());
        return Err(format!("picture `{name}` lacks its source: {wanted}"));
    }
    nodes(root)
}

/// A uri that may name a file, with what is written as `%20` and the like decoded; `None` where that is not UTF-8.
pub(super) fn decoded(uri: &str) -> Option<Cow<'_, str>> {
    if uri.contains(':') {
        // With a scheme it is taken as it is.
        return Some(uri.into());
    }
    urlencoding::decode(uri).ok()
}

/// Nodes are trees (glTF 2.0, 3.5.2).
fn nodes(root: &Root) -> Result<(), String> {
    let name = |node: &Node| node.name.clone().unwrap_or_else(|| "(unnamed)".into());
    let shown = root.scene.as_ref().map_or(0, gltf::json::Index::value);
    let roots = root.scenes.get(shown).into_iter().flat_map(|scene| &scene.nodes);
    let mut waiting: Vec<(usize, usize)> = roots.map(|node| (node.value(), 1)).collect();
    let mut reached = HashSet::new();
    while let Some((index, depth)) = waiting.pop() {
        let Some(node) = root.nodes.get(index) else {
            return Err(format!("there is no node {index}"));
        };
        if !reached.insert(index) {
            return Err(format!(
                "node `{}` is reached twice; a node stands in the scene once, below one parent",
                name(node)
            ));
        }
        if depth > MAX_DEPTH {
            return Err(format!(
                "node `{}` lies more than {MAX_DEPTH} levels deep in others",
                name(node)
            ));
        }
        let has_length = |q: [f32; 4]| glam::Quat::from_array(q).length() > MIN_ROTATION;
        if node.rotation.as_ref().is_some_and(|rotation| !has_length(rotation.0)) {
            return Err(format!("node `{}` has a rotation without length", name(node)));
        }
        let children = node.children.iter().flatten();
        waiting.extend(children.map(|child| (child.value(), depth + 1)));
    }
    Ok(())
}

/// Checks that an accessor is of a type that is allowed, and lies within its buffer.
///
/// # Errors
/// Which accessor is wrong, and what is allowed.
pub(super) fn accessor(
    name: &str,
    accessor: &Accessor<'_>,
    (dimensions, types): (&[Dimensions], &[DataType]),
    buffers: &[gltf::buffer::Data],
) -> Result<(), String> {
    let found = (accessor.dimensions(), accessor.data_type());
    if !dimensions.contains(&found.0) || !types.contains(&found.1) {
        return Err(format!(
            "`{name}` (accessor {}) is of type {:?} of {:?}; allowed are {dimensions:?} of {types:?}",
            accessor.index(),
            found.0,
            found.1
        ));
    }
    extent(name, accessor, buffers)
}

/// Checks that an accessor has one value per position.
///
/// # Errors
/// How many it has.
pub(super) fn count(name: &str, accessor: &Accessor<'_>, n_positions: usize) -> Result<(), String> {
    if accessor.count() == n_positions {
        return Ok(());
    }
    Err(format!(
        "`{name}` has {} values for {n_positions} positions",
        accessor.count()
    ))
}

fn extent(name: &str, accessor: &Accessor<'_>, buffers: &[gltf::buffer::Data]) -> Result<(), String> {
    let beyond = || format!("`{name}` (accessor {}) goes beyond its buffer", accessor.index());
    if accessor.count() == 0 {
        return Err(format!("`{name}` (accessor {}) is empty", accessor.index()));
    }
    let fits = |view: &gltf::buffer::View<'_>, offset: usize, n: usize, size: usize| {
        let stride = view.stride().unwrap_or(size);
        let held = buffers.get(view.buffer().index()).map_or(0, |data| data.0.len());
        let end = (n - 1).checked_mul(stride)?.checked_add(offset)?.checked_add(size)?;
        let view_end = view.offset().checked_add(view.length())?;
        (stride >= size && end <= view.length() && view_end <= held).then_some(())
    };
    match accessor.view() {
        Some(view) => fits(&view, accessor.offset(), accessor.count(), accessor.size()).ok_or_else(beyond)?,
        None if accessor.sparse().is_some() => {}
        None => return Err(format!("`{name}` (accessor {}) has no data", accessor.index())),
    }
    if let Some(sparse) = accessor.sparse() {
        let (indices, values, n) = (sparse.indices(), sparse.values(), sparse.count());
        if n == 0 {
            return Err(format!("`{name}` (accessor {}) replaces no values", accessor.index()));
        }
        fits(&indices.view(), indices.offset(), n, indices.index_type().size()).ok_or_else(beyond)?;
        fits(&values.view(), values.offset(), n, accessor.size()).ok_or_else(beyond)?;
    }
    Ok(())
}

// How a light sees what it shines on (src/shadow/map_view.rs), and what its map tells of a point. World frame, metres.

struct MapView {
    // w: 0 perspective, 1 orthographic.
    position_m: vec4f,
    // Unit axes of the map; w: half its width or height, in perspective at distance 1 m.
    right: vec4f,
    up: vec4f,
    // Direction of view; w: near plane.
    forward: vec4f,
    // x, y: middle of the map, in perspective at distance 1 m; z: far plane; w: 1 where the map's edge goes on outside.
    middle: vec4f,
}

// Maps side by side in one texture.
struct Atlas {
    // x: edge of a map, texels; y: maps per row; z: maps of this light: 1, or 6 faces of a cube.
    shape: vec4u,
}

// A point as a map sees it.
struct Seen {
    // False outside the map, where nothing was drawn.
    is_seen: bool,
    // Place in the map, texels from its upper left corner.
    texel: vec2f,
    // Depth of the point, and how that of its tangent plane grows per texel: the comparison follows the plane, so that
    // lit surfaces need no large bias however slanted.
    depth: f32,
    slope: vec2f,
    depth_per_m: f32,
    // Along the direction of view.
    distance_m: f32,
    // Size of a texel at that distance.
    texel_m: vec2f,
    // Of the angle between the normal and the way to the light.
    cosine: f32,
}

const LEAST_COSINE: f32 = 0.05;

fn map_clip(view: MapView, point: vec3f) -> vec4f {
    let offset = point - view.position_m.xyz;
    let x = dot(offset, view.right.xyz);
    let y = dot(offset, view.up.xyz);
    let z = dot(offset, view.forward.xyz);
    let near = view.forward.w;
    let far = view.middle.z;
    if view.position_m.w > 0.5 {
        return vec4f(x / view.right.w, y / view.up.w, (z - near) / (far - near), 1.0);
    }
    return vec4f(
        (x - view.middle.x * z) / view.right.w,
        (y - view.middle.y * z) / view.up.w,
        far * (z - near) / (far - near),
        z,
    );
}

fn seen_from(view: MapView, size: u32, point: vec3f, normal: vec3f) -> Seen {
    let offset = point - view.position_m.xyz;
    let v = vec3f(dot(offset, view.right.xyz), dot(offset, view.up.xyz), dot(offset, view.forward.xyz));
    let n = vec3f(dot(normal, view.right.xyz), dot(normal, view.up.xyz), dot(normal, view.forward.xyz));
    let half_width = vec2f(view.right.w, view.up.w);
    let near = view.forward.w;
    let far = view.middle.z;
    let texels = f32(size);
    var seen: Seen;
    seen.distance_m = v.z;
    var ndc: vec2f;
    if view.position_m.w > 0.5 {
        ndc = v.xy / half_width;
        seen.is_seen = true;
        seen.depth = (v.z - near) / (far - near);
        seen.depth_per_m = 1.0 / (far - near);
        seen.cosine = -n.z;
        // On the plane n.x x + n.y y + n.z z is constant.
        seen.slope = n.xy / max(-n.z, LEAST_COSINE) * half_width * seen.depth_per_m;
        seen.texel_m = 2.0 * half_width / texels;
    } else {
        seen.is_seen = v.z > 0.0;
        let z = max(v.z, 1e-6);
        ndc = (v.xy / z - view.middle.xy) / half_width;
        let scale = far * near / (far - near);
        seen.depth = far / (far - near) - scale / z;
        seen.depth_per_m = scale / (z * z);
        seen.cosine = -dot(n, v) / max(length(v), 1e-12);
        // On the plane 1 / z = dot(n, ray) / dot(n, v) with ray = (x, y, 1): linear in the map.
        seen.slope = scale * n.xy * half_width / max(-dot(n, v), LEAST_COSINE * length(v));
        seen.texel_m = 2.0 * half_width * z / texels;
    }
    seen.slope *= vec2f(2.0, -2.0) / texels;
    seen.texel = (ndc * vec2f(0.5, -0.5) + 0.5) * texels;
    if any(abs(ndc) >= vec2f(1.0)) {
        seen.is_seen = seen.is_seen && view.middle.w > 0.5;
        seen.slope = vec2f(0.0);
    }
    return seen;
}

// Which of six faces along +x, -x, +y, -y, +z, -z a direction meets.
fn cube_face(direction: vec3f) -> u32 {
    let size = abs(direction);
    if size.x >= size.y && size.x >= size.z {
        return select(1u, 0u, direction.x >= 0.0);
    }
    if size.y >= size.z {
        return select(3u, 2u, direction.y >= 0.0);
    }
    return select(5u, 4u, direction.z >= 0.0);
}

// What a surface must lie behind another one to be in its shadow, in depth: some texels and, for meshes whose normals are
// interpolated, more where the surface is slanted.
fn depth_bias(seen: Seen, texels: f32) -> f32 {
    return texels * (1.0 + 0.5 * slant(seen)) * texel_depth(seen) + 1e-6;
}

// Tangent of the angle between the normal and the way to the light, 10 at most.
fn slant(seen: Seen) -> f32 {
    let cosine = max(seen.cosine, 0.1);
    return sqrt(1.0 - cosine * cosine) / cosine;
}

// The size of a texel as a step of depth.
fn texel_depth(seen: Seen) -> f32 {
    return max(seen.texel_m.x, seen.texel_m.y) * seen.depth_per_m;
}

// Depth that the map of `size` texels at `origin` in the atlas holds at a texel, and that of the seen point's plane there.
fn depths_at(depths: texture_depth_2d, origin: vec2i, size: i32, texel: vec2i, seen: Seen) -> vec2f {
    let inside = clamp(texel, vec2i(0), vec2i(size - 1));
    let plane = seen.depth + dot(seen.slope, vec2f(inside) + 0.5 - seen.texel);
    return vec2f(textureLoad(depths, origin + inside, 0), plane);
}

// 1 where the light reaches the seen point's plane at a texel, else 0. Behind the far plane there are receivers only.
fn lit_at(depths: texture_depth_2d, origin: vec2i, size: i32, texel: vec2i, seen: Seen, bias: f32) -> f32 {
    let both = depths_at(depths, origin, size, texel, seen);
    return select(0.0, 1.0, min(both.y - bias, 1.0) <= both.x);
}

fn map_origin(atlas: Atlas, index: u32) -> vec2i {
    return vec2i(vec2u(index % atlas.shape.y, index / atlas.shape.y) * atlas.shape.x);
}

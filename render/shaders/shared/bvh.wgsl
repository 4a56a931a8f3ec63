// Rays against triangles behind bounding volume hierarchies: bindings 0 and 1 of group 0 (src/shadow/path/hierarchy.rs).
// Several hierarchies may lie in the same buffers; each is named by its root's link.

struct Node {
    low: vec3f,
    // How many triangles (upper 8 bits, 0 for an inner node), and the first triangle or the first of two children.
    link: u32,
    high: vec3f,
    unused: u32,
}

struct Triangle {
    a: vec4f,
    b: vec4f,
    c: vec4f,
}

@group(0) @binding(0) var<storage, read> nodes: array<Node>;
@group(0) @binding(1) var<storage, read> triangles: array<Triangle>;

// Link of a hierarchy without triangles.
const NO_ROOT = 0xffffffffu;
// No triangle.
const NOTHING = 0xffffffffu;
// Farther than anything, metres.
const FAR_M = 1e30;
const FIRST = 0xffffffu;
// Depth of the deepest hierarchy that is uploaded.
const STACK = 64;

struct Ray {
    origin: vec3f,
    direction: vec3f,
    inverse: vec3f,
    // Which axis the direction is longest along, and the shear that turns the direction into that axis.
    axis: u32,
    shear: vec3f,
}

struct Hit {
    distance_m: f32,
    triangle: u32,
    // Weights of the corners.
    weights: vec3f,
}

fn permuted(v: vec3f, axis: u32) -> vec3f {
    return select(select(v.xyz, v.zxy, axis == 1u), v.yzx, axis == 0u);
}

fn ray_from(origin: vec3f, direction: vec3f) -> Ray {
    let size = abs(direction);
    var axis = 2u;
    if size.x >= size.y && size.x >= size.z {
        axis = 0u;
    } else if size.y >= size.z {
        axis = 1u;
    }
    let turned = permuted(direction, axis);
    // Never infinite: 0 times infinity is no number.
    let safe = select(direction, select(vec3f(-1e-20), vec3f(1e-20), direction >= vec3f(0.0)), size < vec3f(1e-20));
    return Ray(origin, direction, 1.0 / safe, axis, vec3f(turned.xy, 1.0) / turned.z);
}

// Distance to a box, FAR_M where the ray misses it or it is beyond `limit`. A rounding error wide of the exact answer, so
// that no box is missed (Ize 2013, "Robust BVH ray traversal").
fn distance_to_box(ray: Ray, low: vec3f, high: vec3f, limit: f32) -> f32 {
    let one = (low - ray.origin) * ray.inverse;
    let other = (high - ray.origin) * ray.inverse;
    let enters = min(one, other);
    let leaves = max(one, other);
    let enter = max(max(enters.x, enters.y), max(enters.z, 0.0));
    let leave = min(leaves.x, min(leaves.y, leaves.z)) * 1.0000005;
    return select(FAR_M, enter, enter <= leave && enter < limit);
}

// The watertight test of Woop, Benthin and Wald 2013: no ray slips between triangles that share an edge. Products may be
// fused with sums on some adapters, so that an edge is as wide as its rounding error.
fn hit_triangle(ray: Ray, index: u32, closest: Hit) -> Hit {
    const ROUNDING = 4e-7;
    let triangle = triangles[index];
    let a = permuted(triangle.a.xyz - ray.origin, ray.axis);
    let b = permuted(triangle.b.xyz - ray.origin, ray.axis);
    let c = permuted(triangle.c.xyz - ray.origin, ray.axis);
    let a2 = a.xy - ray.shear.xy * a.z;
    let b2 = b.xy - ray.shear.xy * b.z;
    let c2 = c.xy - ray.shear.xy * c.z;
    let plus = vec3f(c2.x * b2.y, a2.x * c2.y, b2.x * a2.y);
    let minus = vec3f(c2.y * b2.x, a2.y * c2.x, b2.y * a2.x);
    let edges = plus - minus;
    let width = ROUNDING * (abs(plus) + abs(minus));
    let determinant = edges.x + edges.y + edges.z;
    let is_inside = all(edges >= -width) || all(edges <= width);
    // A triangle seen from its edge has no inside; its neighbours are hit instead.
    if !is_inside || abs(determinant) <= width.x + width.y + width.z {
        return closest;
    }
    let weights = edges / determinant;
    let distance_m = ray.shear.z * dot(weights, vec3f(a.z, b.z, c.z));
    if distance_m <= 0.0 || distance_m >= closest.distance_m {
        return closest;
    }
    return Hit(distance_m, index, weights);
}

// The first triangle along a ray (unit direction), nearer than `limit`.
fn closest_hit(root: u32, origin: vec3f, direction: vec3f, limit: f32) -> Hit {
    var hit = Hit(limit, NOTHING, vec3f(0.0));
    if root == NO_ROOT {
        return hit;
    }
    let ray = ray_from(origin, direction);
    var stack: array<u32, STACK>;
    var height = 0;
    var link = root;
    loop {
        let first = link & FIRST;
        let n = link >> 24u;
        if n > 0u {
            for (var i = first; i < first + n; i++) {
                hit = hit_triangle(ray, i, hit);
            }
        } else {
            let left = nodes[first];
            let right = nodes[first + 1u];
            let to_left = distance_to_box(ray, left.low, left.high, hit.distance_m);
            let to_right = distance_to_box(ray, right.low, right.high, hit.distance_m);
            let is_left_nearer = to_left <= to_right;
            if max(to_left, to_right) < FAR_M {
                stack[height] = select(left.link, right.link, is_left_nearer);
                height++;
            }
            if min(to_left, to_right) < FAR_M {
                link = select(right.link, left.link, is_left_nearer);
                continue;
            }
        }
        if height == 0 {
            break;
        }
        height--;
        link = stack[height];
    }
    return hit;
}

// Whether any triangle stands along a ray (unit direction), nearer than `limit`.
fn any_hit(root: u32, origin: vec3f, direction: vec3f, limit: f32) -> bool {
    if root == NO_ROOT {
        return false;
    }
    let ray = ray_from(origin, direction);
    let nothing = Hit(limit, NOTHING, vec3f(0.0));
    var stack: array<u32, STACK>;
    var height = 0;
    var link = root;
    loop {
        let first = link & FIRST;
        let n = link >> 24u;
        if n > 0u {
            for (var i = first; i < first + n; i++) {
                if hit_triangle(ray, i, nothing).triangle != NOTHING {
                    return true;
                }
            }
        } else {
            let left = nodes[first];
            let right = nodes[first + 1u];
            let is_left = distance_to_box(ray, left.low, left.high, limit) < FAR_M;
            let is_right = distance_to_box(ray, right.low, right.high, limit) < FAR_M;
            if is_left && is_right {
                stack[height] = right.link;
                height++;
            }
            if is_left || is_right {
                link = select(right.link, left.link, is_left);
                continue;
            }
        }
        if height == 0 {
            break;
        }
        height--;
        link = stack[height];
    }
    return false;
}

// A place just off a surface, on the side of the unit vector `side`, so that a ray from it does not hit where it starts
// (Wächter and Binder 2019, "A fast and robust method for avoiding self-intersection").
fn off_surface(place: vec3f, side: vec3f) -> vec3f {
    let steps = vec3i(256.0 * side);
    let moved = bitcast<vec3f>(bitcast<vec3i>(place) + select(steps, -steps, place < vec3f(0.0)));
    return select(moved, place + side / 65536.0, abs(place) < vec3f(1.0 / 32.0));
}

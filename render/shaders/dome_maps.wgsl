// Depth maps of all lights of a dome: a thread draws one triangle into every map that is refreshed, so that its corners are
// loaded once. Stored is 1 at the near plane and 0 at the far one; the greatest wins, and empty is 0.

#import dome

struct Object {
    world_from_object: mat4x4f,
    environment: vec4u,
}

// xyz: place in the object's frame; w: the object's index, bit for bit.
@group(0) @binding(2) var<storage, read> corners: array<vec4f>;
@group(0) @binding(3) var<storage, read> objects: array<Object>;
@group(0) @binding(4) var<storage, read_write> maps: array<atomic<u32>>;

// x, y in texels, stored depth.
fn projected(light: DomeLight, point: vec4f) -> vec3f {
    let z = max(dot(light.forward, point), 1e-4);
    let half_size = 0.5 * f32(frame.counts.y);
    let ndc = vec2f(dot(light.right, point), -dot(light.up, point)) / z;
    return vec3f(ndc * half_size + half_size, light.depth.x - light.depth.y / z);
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let triangle = id.x + id.y * groups.x * 64u;
    if triangle >= frame.sizes.x {
        return;
    }
    let object = bitcast<u32>(corners[3u * triangle].w);
    let world_from_object = objects[object].world_from_object;
    let a_world = world_from_object * vec4f(corners[3u * triangle].xyz, 1.0);
    let b_world = world_from_object * vec4f(corners[3u * triangle + 1u].xyz, 1.0);
    let c_world = world_from_object * vec4f(corners[3u * triangle + 2u].xyz, 1.0);
    let size = f32(frame.counts.y);
    for (var i = frame.counts.z; i < frame.counts.w; i++) {
        let light = lights[i];
        if light.intensity.w == 0.0 {
            continue;
        }
        let a = projected(light, a_world);
        let b = projected(light, b_world);
        let c = projected(light, c_world);
        let ab = b - a;
        let ac = c - a;
        let area = ab.x * ac.y - ab.y * ac.x;
        if abs(area) < 1e-9 {
            continue;
        }
        // Texels whose middles lie in the triangle.
        let low = max(ceil(min(min(a.xy, b.xy), c.xy) - 0.5), vec2f(0.0));
        let high = min(floor(max(max(a.xy, b.xy), c.xy) - 0.5), vec2f(size - 1.0));
        if any(low > high) {
            continue;
        }
        // Depth over the triangle is a plane in the map; its slope, half a texel each way, is the bias.
        let slope = vec2f(ab.z * ac.y - ac.z * ab.y, ac.z * ab.x - ab.z * ac.x) / area;
        let bias = 0.5 * (abs(slope.x) + abs(slope.y)) + 2e-5;
        let nearest = max(max(a.z, b.z), c.z);
        for (var y = low.y; y <= high.y; y += 1.0) {
            for (var x = low.x; x <= high.x; x += 1.0) {
                let at = vec2f(x + 0.5, y + 0.5) - a.xy;
                let v = (at.x * ac.y - at.y * ac.x) / area;
                let w = (ab.x * at.y - ab.y * at.x) / area;
                if v >= -1e-4 && w >= -1e-4 && v + w <= 1.0002 {
                    let depth = clamp(min(a.z + dot(slope, at), nearest) - bias, 0.0, 1.0);
                    atomicMax(&maps[(i * frame.counts.y + u32(y)) * frame.counts.y + u32(x)], bitcast<u32>(depth));
                }
            }
        }
    }
}

// Cube maps addressed by direction in the world frame; faces +x -x +y -y +z -z, rows from the top.

fn face_direction(face: u32, uv: vec2f) -> vec3f {
    switch face {
        case 0u: { return vec3f(1.0, -uv.y, -uv.x); }
        case 1u: { return vec3f(-1.0, -uv.y, uv.x); }
        case 2u: { return vec3f(uv.x, 1.0, uv.y); }
        case 3u: { return vec3f(uv.x, -1.0, -uv.y); }
        case 4u: { return vec3f(uv.x, -uv.y, 1.0); }
        default: { return vec3f(-uv.x, -uv.y, -1.0); }
    }
}

// Unit direction through a place in a texel; `offset` 0.5 is its centre.
fn texel_direction(size: u32, texel: vec3u, offset: vec2f) -> vec3f {
    let uv = (vec2f(texel.xy) + offset) / f32(size) * 2.0 - 1.0;
    return normalize(face_direction(texel.z, uv));
}

// Index of the texel that a direction falls into.
fn texel_index(size: u32, d: vec3f) -> u32 {
    let a = abs(d);
    var face: u32;
    var uv: vec2f;
    if a.x >= a.y && a.x >= a.z {
        face = select(1u, 0u, d.x > 0.0);
        uv = vec2f(select(d.z, -d.z, d.x > 0.0), -d.y) / a.x;
    } else if a.y >= a.z {
        face = select(3u, 2u, d.y > 0.0);
        uv = vec2f(d.x, select(-d.z, d.z, d.y > 0.0)) / a.y;
    } else {
        face = select(5u, 4u, d.z > 0.0);
        uv = vec2f(select(-d.x, d.x, d.z > 0.0), -d.y) / a.z;
    }
    let texel = min(vec2u((uv + 1.0) * 0.5 * f32(size)), vec2u(size - 1u));
    return (face * size + texel.y) * size + texel.x;
}

// Solid angle of a texel in steradians (to 1 part in the number of texels).
fn texel_solid_angle(size: u32, texel: vec3u) -> f32 {
    let uv = (vec2f(texel.xy) + 0.5) / f32(size) * 2.0 - 1.0;
    let r2 = 1.0 + dot(uv, uv);
    return 4.0 / (f32(size) * f32(size) * r2 * sqrt(r2));
}

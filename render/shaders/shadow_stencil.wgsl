// Black wherever the stencil test lets a triangle over the whole picture through, at the depth of infinity.

@vertex
fn vertex(@builtin(vertex_index) i: u32) -> @builtin(position) vec4f {
    return vec4f(f32(4u * (i & 1u)) - 1.0, f32(2u * (i & 2u)) - 1.0, 1.0, 1.0);
}

@fragment
fn fragment() -> @location(0) vec4f {
    return vec4f(0.0, 0.0, 0.0, 1.0);
}

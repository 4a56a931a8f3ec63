// Places within a pixel of a surface, from what its neighbours show. The importing shader declares `places` (w: 1 where there
// is a surface) and `gloss` (xyz: normals).

// Places along each edge of a pixel.
const SPOTS = 3u;

// What changes of place and normal from a pixel to the next one.
struct Slope {
    place: vec3f,
    normal: vec3f,
}

// A place on a surface with the normal of its substance.
struct Spot {
    place: vec3f,
    normal: vec3f,
}

fn slope_to(pixel: vec2i, step: vec2i, here: Spot, sense: f32) -> Slope {
    let at = pixel + step;
    let size = vec2i(textureDimensions(places));
    let there = textureLoad(places, clamp(at, vec2i(0), size - 1), 0);
    let normal = textureLoad(gloss, clamp(at, vec2i(0), size - 1), 0).xyz;
    let is_same = there.w > 0.0 && dot(normal, here.normal) > 0.9 && all(at >= vec2i(0)) && all(at < size);
    return Slope(
        select(vec3f(0.0), sense * (there.xyz - here.place), is_same),
        select(vec3f(0.0), sense * (normal - here.normal), is_same),
    );
}

// The smaller change of those to both sides: the other one may lead over an edge.
fn slope_along(pixel: vec2i, step: vec2i, here: Spot) -> Slope {
    let ahead = slope_to(pixel, step, here, 1.0);
    let back = slope_to(pixel, -step, here, -1.0);
    let size = vec2f(dot(ahead.place, ahead.place), dot(back.place, back.place));
    let is_ahead = size.y == 0.0 || (size.x > 0.0 && size.x <= size.y);
    if is_ahead {
        return ahead;
    }
    return back;
}

// How a surface goes on within a pixel.
struct PixelShape {
    right: Slope,
    down: Slope,
    // Of the part of the pixel that a spot stands for: metres across the surface, and change of the normal. Bent edges sweep
    // long and thin parts; the width is between their length and their width, as averages are round.
    width_m: f32,
    turned: f32,
    // How far the surface may bend away from the straight lines along which spots are taken, metres.
    rise_m: f32,
}

fn pixel_shape(pixel: vec2i, here: Spot) -> PixelShape {
    let right = slope_along(pixel, vec2i(1, 0), here);
    let down = slope_along(pixel, vec2i(0, 1), here);
    return PixelShape(
        right,
        down,
        sqrt(length(right.place) * length(down.place)) / f32(SPOTS),
        sqrt(length(right.normal) * length(down.normal)) / f32(SPOTS),
        0.25 * (length(right.place) * length(right.normal) + length(down.place) * length(down.normal)),
    );
}

// Spot `i` of SPOTS².
fn spot_of(shape: PixelShape, here: Spot, i: u32) -> Spot {
    let offset = (vec2f(vec2u(i % SPOTS, i / SPOTS)) + 0.5) / f32(SPOTS) - 0.5;
    return Spot(
        here.place + shape.right.place * offset.x + shape.down.place * offset.y,
        normalize(here.normal + shape.right.normal * offset.x + shape.down.normal * offset.y),
    );
}

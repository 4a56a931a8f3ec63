// Cells of 4 × 4 pixels: the reflectance that the picture and the predicted light give the phantom there.

#import camera
#import lights
#import sh

#import direct
#import picture
#import protect
#import protect_pixel

@group(0) @binding(14) var<storage, read_write> cells: array<Cell>;

@compute @workgroup_size(8, 8, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let size = textureDimensions(places);
    let columns = (size.x + CELL_PX - 1u) / CELL_PX;
    let first = CELL_PX * id.xy;
    if any(first >= size) {
        return;
    }
    let middle = min(first + CELL_PX / 2u, size - 1u);
    let place = textureLoad(places, middle, 0);
    let normal = textureLoad(normals, middle, 0);
    var cell = Cell(vec4f(0.0), vec4f(0.0), place, normal);
    let from_ball = distance(place.xyz, frame.ball_m.xyz);
    // A mirror shows no reflectance.
    if place.w > 0.0 && abs(from_ball - frame.ball_m.w) >= 0.02 * frame.ball_m.w {
        let near = near_irradiance(nearest_environment(place.xyz, frame.counts.x), normal.xyz);
        var radiance = vec3f(0.0);
        var irradiance = vec3f(0.0);
        var bright = vec3f(0.0);
        var n = 0u;
        for (var i = 0u; i < CELL_PX * CELL_PX; i++) {
            let at = min(first + vec2u(i % CELL_PX, i / CELL_PX), size - 1u);
            let there = textureLoad(places, at, 0);
            if there.w == 0.0 || !is_same_plane(place.xyz, normal.xyz, there.xyz, textureLoad(normals, at, 0).xyz) {
                continue;
            }
            let pixel = phantom_pixel(at, near);
            if pixel.is_clear {
                radiance += pixel.radiance;
                irradiance += pixel.irradiance;
                bright += pixel.bright;
                n++;
            }
        }
        if n > CELL_PX * CELL_PX / 2u {
            cell.log_reflectance = vec4f(log_reflectance(radiance, irradiance), 1.0);
            cell.share = vec4f(bright / max(irradiance, vec3f(1e-9)), 0.0);
        }
    }
    cells[id.y * columns + id.x] = cell;
}

// Rays to places on lamps. Needs `lamp` and `sampling`.

struct LampRay {
    // Unit direction to the place, and how far it is.
    towards: vec3f,
    reach_m: f32,
    // Irradiance on a surface that faces the place, relative to the lamp's, if all light came from there. Its mean over the
    // lamp is what the lamp gives.
    strength: f32,
}

// A place on a lamp, evenly spread over the unit square: by area on a rectangle, by solid angle on what is round.
fn lamp_ray(lamp: Lamp, point: vec3f, u: vec2f) -> LampRay {
    if lamp.position_m.w == LAMP_RECTANGLE {
        let place = lamp.position_m.xyz + (2.0 * u.x - 1.0) * lamp.across.xyz + (2.0 * u.y - 1.0) * lamp.along.xyz;
        let to_place = place - point;
        let distance_m = max(length(to_place), 0.01);
        let towards = to_place / distance_m;
        return LampRay(towards, distance_m, max(-dot(towards, lamp.direction.xyz), 0.0) / (distance_m * distance_m));
    }
    let seen = lamp_seen(lamp, point);
    let reach_m = seen.distance_m * (1.0 - seen.sine);
    if seen.sine == 0.0 {
        return LampRay(seen.towards, reach_m, seen.strength);
    }
    let cosine = sqrt(1.0 - seen.sine * seen.sine);
    let z = 1.0 - u.x * (1.0 - cosine);
    let radius = sqrt(max(1.0 - z * z, 0.0));
    let angle = 6.2831853 * u.y;
    let towards = basis_around(seen.towards) * vec3f(radius * cos(angle), radius * sin(angle), z);
    // Radiance times solid angle: a disc of sine s has irradiance π s² L, and 2π (1 - cosine) of solid angle.
    return LampRay(towards, reach_m, seen.strength * 2.0 / (1.0 + cosine));
}

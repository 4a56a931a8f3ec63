// Light from afar for rays: lights that stand where the light was found, and shadow rays to them. The importing shader
// declares `probe: FarLights`, and imports `bvh` and `scene_ray` (src/near/far_lights.rs). World frame, metres.

struct FarLight {
    // w: tangent of half the angle that it fills.
    position_m: vec4f,
    // Irradiance is intensity cos / distance².
    intensity: vec4f,
}

struct FarLights {
    // xyz: where the light was measured; w: number of lights.
    position_m: vec4f,
    lights: array<FarLight, 256>,
}

// Whether any object stands along a ray (unit direction), nearer than `limit`.
fn is_blocked(origin: vec3f, direction: vec3f, limit: f32) -> bool {
    for (var i = 0u; i < arrayLength(&instances); i++) {
        let facts = instances[i].facts;
        if (facts.y & ALL_OBJECTS) == 0u || facts.x == NO_ROOT {
            continue;
        }
        let start = (instances[i].object_from_world * vec4f(origin, 1.0)).xyz;
        let way = (instances[i].object_from_world * vec4f(direction, 0.0)).xyz;
        let scale = length(way);
        let towards = way / scale;
        let sphere = instances[i].sphere_m;
        let to_center = sphere.xyz - start;
        let along = dot(to_center, towards);
        let off2 = dot(to_center, to_center) - along * along;
        if off2 > sphere.w * sphere.w || along < -sphere.w || along - sphere.w > limit * scale {
            continue;
        }
        if any_hit(facts.x, start, towards, limit * scale) {
            return true;
        }
    }
    return false;
}

// Irradiance of one light where nothing stands in its way.
fn unblocked_irradiance(light: u32, place: vec3f, normal: vec3f) -> vec3f {
    let to_light = probe.lights[light].position_m.xyz - place;
    let distance2 = dot(to_light, to_light);
    return probe.lights[light].intensity.rgb * (max(dot(normal, to_light), 0.0) / (distance2 * sqrt(distance2)));
}

// Irradiance from afar past all objects, estimated with one ray to one light, chosen by what each would give (weighted
// reservoir: Chao 1982). `choice` and `disk` lie in the unit interval and square.
fn far_irradiance(place: vec3f, normal: vec3f, choice: f32, disk: vec2f) -> vec3f {
    var total = 0.0;
    var chosen = 0u;
    var luminance = 0.0;
    // Kept below 1 against rounding.
    var left = min(choice, 0.9999999);
    let n = u32(probe.position_m.w);
    for (var i = 0u; i < n; i++) {
        let given = dot(unblocked_irradiance(i, place, normal), vec3f(0.2126, 0.7152, 0.0722));
        if given <= 0.0 {
            continue;
        }
        total += given;
        let share = given / total;
        if left < share {
            chosen = i;
            luminance = given;
            left = min(left / share, 0.9999999);
        } else {
            left = clamp((left - share) / (1.0 - share), 0.0, 0.9999999);
        }
    }
    if total == 0.0 {
        return vec3f(0.0);
    }
    let light = probe.lights[chosen].position_m;
    let to_light = light.xyz - place;
    let axes = basis_around(normalize(to_light));
    let radius = sqrt(disk.x) * light.w * length(to_light);
    let angle = 6.2831853 * disk.y;
    let way = to_light + radius * (cos(angle) * axes[0] + sin(angle) * axes[1]);
    if is_blocked(place, normalize(way), length(way)) {
        return vec3f(0.0);
    }
    return unblocked_irradiance(chosen, place, normal) * (total / luminance);
}

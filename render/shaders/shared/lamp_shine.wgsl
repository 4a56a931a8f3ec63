// Highlights of virtual lamps on virtual objects: GGX with each lamp as the one of its points that the eye sees mirrored best
// (Karis 2013, "Real shading in Unreal Engine 4", area lights). Needs `brdf` and `lamp`.

@group(2) @binding(0) var<uniform> lamps: Lamps;
// Share of every lamp that reaches the surface, four lamps per layer.
@group(2) @binding(1) var lamp_shares: texture_2d_array<f32>;

// A point lamp in a smooth mirror is shown as a spot of about 1°.
const SMOOTHEST_ALPHA: f32 = 0.02;

struct Gloss {
    normal: vec3f,
    to_eye: vec3f,
    // GGX alpha.
    alpha: f32,
    // Reflectance at normal and at grazing incidence.
    f0: vec3f,
    f90: f32,
}

// Unit direction to the point of a lamp nearest to the mirrored direction; w: half the lamp's size over its distance.
fn mirrored_point(lamp: Lamp, seen: LampSeen, mirrored: vec3f) -> vec4f {
    if lamp.position_m.w == LAMP_RECTANGLE {
        let to_middle = seen.towards * seen.distance_m;
        let towards_plane = dot(mirrored, lamp.direction.xyz);
        var met = to_middle;
        if towards_plane < -1e-3 {
            met = mirrored * (dot(to_middle, lamp.direction.xyz) / towards_plane);
        }
        let off = met - to_middle;
        let x = clamp(dot(off, lamp.across.xyz) / dot(lamp.across.xyz, lamp.across.xyz), -1.0, 1.0);
        let y = clamp(dot(off, lamp.along.xyz) / dot(lamp.along.xyz, lamp.along.xyz), -1.0, 1.0);
        // A disc of the same area.
        let radius = sqrt(4.0 / 3.1415927 * length(lamp.across.xyz) * length(lamp.along.xyz));
        return vec4f(normalize(to_middle + x * lamp.across.xyz + y * lamp.along.xyz), radius / seen.distance_m);
    }
    let off = dot(seen.towards, mirrored) * mirrored - seen.towards;
    let nearest = seen.towards + off * saturate(seen.sine / max(length(off), 1e-6));
    return vec4f(normalize(nearest), seen.sine);
}

// Height-correlated masking and shadowing of Smith over 4 n·l n·v (Heitz 2014, eq. 99), times n·l.
fn masked_cosine(normal_light: f32, normal_eye: f32, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let light = normal_eye * sqrt(normal_light * normal_light * (1.0 - a2) + a2);
    let eye = normal_light * sqrt(normal_eye * normal_eye * (1.0 - a2) + a2);
    return 0.5 * normal_light / max(light + eye, 1e-6);
}

// Radiance that a surface at `point`, shown by `pixel`, mirrors of the lamps.
fn lamp_highlights(pixel: vec2i, point: vec3f, gloss: Gloss) -> vec3f {
    let mirrored = reflect(-gloss.to_eye, gloss.normal);
    let alpha = max(gloss.alpha, SMOOTHEST_ALPHA);
    var sum = vec3f(0.0);
    for (var i = 0u; i < lamps.counts.x; i++) {
        let share = textureLoad(lamp_shares, pixel, i / 4u, 0)[i % 4u];
        let seen = lamp_seen(lamps.all[i], point);
        if share * seen.strength <= 0.0 {
            continue;
        }
        let place = mirrored_point(lamps.all[i], seen, mirrored);
        let half_vector = normalize(place.xyz + gloss.to_eye);
        let normal_light = dot(gloss.normal, place.xyz);
        if normal_light <= 0.0 {
            continue;
        }
        // The lobe as wide as lobe and lamp together keeps the energy; with half the lamp's size a mirror shows its radiance.
        let wide = min(alpha + 0.5 * place.w, 1.0);
        let spread = alpha / wide;
        let grazing = pow(1.0 - saturate(dot(half_vector, gloss.to_eye)), 5.0);
        let fresnel = mix(gloss.f0, vec3f(gloss.f90), grazing);
        let lobe = ggx_distribution(saturate(dot(gloss.normal, half_vector)), alpha) * spread * spread;
        let masked = masked_cosine(normal_light, max(dot(gloss.normal, gloss.to_eye), 1e-3), alpha);
        sum += share * seen.strength * lobe * masked * fresnel * lamps.all[i].irradiance.rgb;
    }
    return sum;
}

// Virtual lamps (src/passes/lamp_light.rs). World frame, metres. The importing shader declares `lamps`, a uniform `Lamps`.

struct Lamp {
    // xyz: its middle; w: LAMP_BALL, LAMP_DISTANT or LAMP_RECTANGLE.
    position_m: vec4f,
    // xyz: unit direction in which it shines; w: radius of a ball, sine of a distant lamp's angular radius.
    direction: vec4f,
    // xyz: half of a rectangle's first side; w: cosine of the angle that a ball shines into fully.
    across: vec4f,
    // xyz: half of its second side; w: cosine of the angle beyond which a ball does not shine.
    along: vec4f,
    // Irradiance on a surface that faces it 1 m away, linear RGB.
    irradiance: vec4f,
}

struct Lamps {
    // x: how many there are; y: one bit for each whose shadows are soft.
    counts: vec4u,
    all: array<Lamp, 8>,
}

const LAMP_BALL = 0.0;
const LAMP_DISTANT = 1.0;
const LAMP_RECTANGLE = 2.0;
// How far off a distant lamp is taken to be, metres.
const LAMP_FAR_M = 1e4;

// A lamp as a point sees it.
struct LampSeen {
    // Unit direction to its middle, and how far it is.
    towards: vec3f,
    distance_m: f32,
    // Sine of half the angle that a ball or a distant lamp fills; 0 for a rectangle.
    sine: f32,
    // Irradiance on a surface that faces the middle, relative to the lamp's; all of the lamp's light at its middle.
    strength: f32,
}

fn is_lamp_soft(index: u32) -> bool {
    return (lamps.counts.y & (1u << index)) != 0u;
}

// Share of a ball's light in a direction off its axis (KHR_lights_punctual, "inner and outer cone angles").
fn in_cone(lamp: Lamp, cosine: f32) -> f32 {
    let inside = saturate((cosine - lamp.along.w) / max(lamp.across.w - lamp.along.w, 0.001));
    return inside * inside;
}

fn lamp_seen(lamp: Lamp, point: vec3f) -> LampSeen {
    if lamp.position_m.w == LAMP_DISTANT {
        return LampSeen(-lamp.direction.xyz, LAMP_FAR_M, lamp.direction.w, 1.0);
    }
    let to_lamp = lamp.position_m.xyz - point;
    // A lamp is never nearer than 1 cm: light next to a point would have no bounds.
    let distance_m = max(length(to_lamp), 0.01);
    let towards = to_lamp / distance_m;
    let ahead = -dot(towards, lamp.direction.xyz);
    let square = distance_m * distance_m;
    if lamp.position_m.w == LAMP_RECTANGLE {
        return LampSeen(towards, distance_m, 0.0, max(ahead, 0.0) / square);
    }
    let sine = min(lamp.direction.w / distance_m, 0.999);
    return LampSeen(towards, distance_m, sine, in_cone(lamp, ahead) / square);
}

// Whether a cell lies in a shadow that the prediction does not know: its surface has places whose reflectance is that of the
// cell over the share of light that the bright ones leave, in every channel, and fewer of the cell's own reflectance. CPU
// twin: src/reference/protect.rs.

#import protect

// Columns and rows of cells; z: every so many-th column and row is asked.
@group(0) @binding(0) var<uniform> grid: vec4u;
@group(0) @binding(1) var<storage, read> cells: array<Cell>;
@group(0) @binding(2) var<storage, read_write> verdicts: array<Verdict>;

// A light that gives less than this share takes no more from a surface than its own pattern does.
const LEAST_SHARE: f32 = 0.4;
// Standard deviation of a surface's pattern and of the predicted light's error in logarithms: of brightness, and of colour,
// which both change less. A shadow may be darker: what throws it takes some of the soft light as well.
const BRIGHTNESS_SIGMA: f32 = 0.15;
const DARKER_SIGMA: f32 = 0.35;
const COLOR_SIGMA: f32 = 0.07;
// Belief in unknown shadows before looking, against none; and places that must speak for it, whatever the others say.
const PRIOR: f32 = 0.5;
const LEAST_SUPPORT: f32 = 1.0;
// Less belief is none.
const LEAST_BELIEF: f32 = 0.05;

// How alike two reflectances are whose logarithms differ so, 1 for the same; `darker_sigma` is for a positive difference.
fn likeness(difference: vec3f, darker_sigma: f32) -> f32 {
    let brightness = dot(difference, vec3f(1.0 / 3.0));
    let color = difference - brightness;
    let in_sigmas = brightness / select(BRIGHTNESS_SIGMA, darker_sigma, brightness > 0.0);
    return exp(-0.5 * (in_sigmas * in_sigmas + dot(color, color) / (COLOR_SIGMA * COLOR_SIGMA)));
}

fn verdict(cell: Cell) -> vec4f {
    let share = cell.share.rgb;
    if cell.log_reflectance.w == 0.0 || dot(share, vec3f(1.0 / 3.0)) < LEAST_SHARE {
        return vec4f(0.0);
    }
    let log_left = log(max(1.0 - share, vec3f(0.01)));
    var as_seen = 0.0;
    var as_shaded = 0.0;
    var reference = vec3f(0.0);
    for (var y = grid.z / 2u; y < grid.y; y += grid.z) {
        for (var x = grid.z / 2u; x < grid.x; x += grid.z) {
            let other = cells[y * grid.x + x];
            if other.log_reflectance.w == 0.0
                || !is_same_plane(cell.place_m.xyz, cell.normal.xyz, other.place_m.xyz, other.normal.xyz) {
                continue;
            }
            let difference = other.log_reflectance.xyz - cell.log_reflectance.xyz;
            as_seen += likeness(difference, BRIGHTNESS_SIGMA);
            let support = likeness(difference + log_left, DARKER_SIGMA);
            as_shaded += support;
            reference += support * other.log_reflectance.xyz;
        }
    }
    let belief = PRIOR * as_shaded / (PRIOR * as_shaded + as_seen + LEAST_SUPPORT);
    if belief < LEAST_BELIEF {
        return vec4f(0.0);
    }
    return vec4f(reference / as_shaded, belief);
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= grid.x * grid.y {
        return;
    }
    verdicts[id.x].shaded = verdict(cells[id.x]);
}

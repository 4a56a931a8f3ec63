// How a surface scatters light, in its own frame (z: its normal, on the eye's side): diffuse below a GGX coat, GGX metal, a
// perfect mirror where the roughness is next to nothing, smooth glass. glTF 2.0, appendix B, without its simplifications of
// the Fresnel term for glass. Needs `sampling` and `microfacets`.

struct PathMaterial {
    // Linear base colour; w: metallic.
    color: vec4f,
    // Dielectric reflectance at normal incidence; w: at grazing incidence.
    dielectric: vec4f,
    // x: GGX alpha; y: transmission; z: index of refraction; w: unused.
    parameters: vec4f,
}

// Below this alpha a surface is a perfect mirror.
const MIRROR_ALPHA = 1e-3;

struct Scattered {
    // Share of the radiance that goes on, per steradian, cosine included.
    value: vec3f,
    // Density per steradian with which `scatter` draws the direction.
    density: f32,
}

struct Bounce {
    direction: vec3f,
    // `Scattered::value` over its density; 0 where the path ends.
    weight: vec3f,
    // 0 for a mirrored or refracted direction: no other one is possible.
    density: f32,
}

fn schlick(f0: vec3f, f90: f32, cosine: f32) -> vec3f {
    let x = clamp(1.0 - cosine, 0.0, 1.0);
    let x2 = x * x;
    return f0 + (vec3f(f90) - f0) * (x2 * x2 * x);
}

fn reflectance(material: PathMaterial, cosine: f32) -> vec3f {
    let dielectric = schlick(material.dielectric.rgb, material.dielectric.w, cosine);
    return mix(dielectric, schlick(material.color.rgb, 1.0, cosine), material.color.w);
}

fn glass_share(material: PathMaterial) -> f32 {
    return (1.0 - material.color.w) * material.parameters.y;
}

// How often the coat is drawn rather than the diffuse base.
fn coat_share(material: PathMaterial, cosine: f32) -> f32 {
    let coat = dot(reflectance(material, cosine), vec3f(1.0));
    let base = (1.0 - material.color.w) * dot(material.color.rgb, vec3f(1.0));
    if base <= 0.0 || coat <= 0.0 {
        return select(0.0, 1.0, coat > 0.0);
    }
    return clamp(coat / (coat + base), 0.1, 0.9);
}

// Scattering from `incoming` to `outgoing`, both unit and above the surface, mirrored and refracted light left out.
fn scattered(material: PathMaterial, outgoing: vec3f, incoming: vec3f) -> Scattered {
    if outgoing.z <= 0.0 || incoming.z <= 0.0 {
        return Scattered(vec3f(0.0), 0.0);
    }
    let middle = normalize(outgoing + incoming);
    let cosine = dot(outgoing, middle);
    let coat = coat_share(material, outgoing.z);
    let passed = 1.0 - schlick(material.dielectric.rgb, material.dielectric.w, cosine);
    let diffuse = incoming.z * 0.31830987;
    var value = (1.0 - material.color.w) * material.color.rgb * passed * diffuse;
    var density = (1.0 - coat) * diffuse;
    let alpha = material.parameters.x;
    if alpha >= MIRROR_ALPHA && coat > 0.0 {
        let slope = middle.xy / alpha;
        let stretched = dot(slope, slope) + middle.z * middle.z;
        // GGX's distribution in a form that small alphas do not cancel (Heitz 2018, eq. 1).
        let facets = 1.0 / (3.1415927 * alpha * alpha * stretched * stretched);
        let out_lambda = smith_lambda(outgoing, alpha);
        let in_lambda = smith_lambda(incoming, alpha);
        let even = facets / (4.0 * outgoing.z);
        value += reflectance(material, cosine) * (even / (1.0 + out_lambda + in_lambda));
        density += coat * even / (1.0 + out_lambda);
    }
    let opaque = 1.0 - glass_share(material);
    return Scattered(opaque * value, opaque * density);
}

// Where the path goes on. `eta`: index of refraction on the eye's side over that on the other.
fn scatter(material: PathMaterial, outgoing: vec3f, eta: f32, u: vec2f, choice: f32) -> Bounce {
    let mirrored = vec3f(-outgoing.xy, outgoing.z);
    let glass = glass_share(material);
    if choice < glass {
        let reflected = fresnel(outgoing.z, eta);
        if choice < reflected * glass {
            return Bounce(mirrored, vec3f(1.0), 0.0);
        }
        // Radiance is squeezed as the solid angle is (Veach 1997, section 5.2).
        let inner = sqrt(max(1.0 - eta * eta * (1.0 - outgoing.z * outgoing.z), 0.0));
        return Bounce(vec3f(-eta * outgoing.xy, -inner), eta * eta * material.color.rgb, 0.0);
    }
    let rest = (choice - glass) / (1.0 - glass);
    let coat = coat_share(material, outgoing.z);
    let alpha = material.parameters.x;
    var direction: vec3f;
    if rest < coat {
        if alpha < MIRROR_ALPHA {
            return Bounce(mirrored, reflectance(material, outgoing.z) / coat, 0.0);
        }
        direction = reflect(-outgoing, visible_normal(outgoing, alpha, u));
    } else {
        direction = cosine_direction(u);
    }
    let found = scattered(material, outgoing, direction);
    if found.density <= 0.0 {
        return Bounce(direction, vec3f(0.0), 0.0);
    }
    return Bounce(direction, found.value / found.density, found.density);
}

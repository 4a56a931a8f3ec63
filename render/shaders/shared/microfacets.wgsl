// Facets of rough surfaces, in the surface's own frame (z: its normal), and the reflectance of smooth glass.

// Smith's shadowing function of GGX less 1 (Heitz 2014, eq. 72, with its Lambda).
fn smith_lambda(direction: vec3f, alpha: f32) -> f32 {
    let tangent2 = dot(direction.xy, direction.xy) / (direction.z * direction.z);
    return 0.5 * (sqrt(1.0 + alpha * alpha * tangent2) - 1.0);
}

// Facet's normal among those that `outgoing` sees (Heitz 2018, "Sampling the GGX distribution of visible normals").
fn visible_normal(outgoing: vec3f, alpha: f32, u: vec2f) -> vec3f {
    let eye = normalize(vec3f(alpha * outgoing.xy, outgoing.z));
    let across = dot(eye.xy, eye.xy);
    var one = vec3f(1.0, 0.0, 0.0);
    if across > 0.0 {
        one = vec3f(-eye.y, eye.x, 0.0) * inverseSqrt(across);
    }
    let other = cross(eye, one);
    let radius = sqrt(u.x);
    let angle = 6.2831853 * u.y;
    let x = radius * cos(angle);
    let s = 0.5 * (1.0 + eye.z);
    let y = (1.0 - s) * sqrt(max(1.0 - x * x, 0.0)) + s * radius * sin(angle);
    let normal = x * one + y * other + sqrt(max(1.0 - x * x - y * y, 0.0)) * eye;
    return normalize(vec3f(alpha * normal.xy, max(normal.z, 0.0)));
}

// Reflectance of smooth glass; `eta`: index on this side over that on the other.
fn fresnel(cosine: f32, eta: f32) -> f32 {
    let sine2 = eta * eta * (1.0 - cosine * cosine);
    if sine2 >= 1.0 {
        return 1.0;
    }
    let inner = sqrt(1.0 - sine2);
    let parallel = (cosine - eta * inner) / (cosine + eta * inner);
    let across = (eta * cosine - inner) / (eta * cosine + inner);
    return 0.5 * (parallel * parallel + across * across);
}

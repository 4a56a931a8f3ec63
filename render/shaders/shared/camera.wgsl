// A real camera: lens, photometry, pose. Frames: world in metres; camera x right, y down, z forward; pixel centres at integers.

struct Camera {
    focal_and_principal_px: vec4f,
    camera_from_world: mat4x4f,
    common_from_camera: mat4x4f,
    camera_from_common: mat4x4f,
    position_m: vec4f,
    distortion: vec4f,
    denominator: vec4f,
    limits: vec4f,
    signal_per_radiance: vec4f,
    vignetting_and_depth: vec4f,
}

fn is_fisheye(camera: Camera) -> bool {
    return camera.position_m.w > 0.5;
}

// Distance from the principal point, in focal lengths, at an angle to the axis.
fn fisheye_radius(camera: Camera, theta: f32) -> f32 {
    if camera.position_m.w > 2.5 {
        // Double sphere (Usenko et al. 2018), which with xi = 0 is the unified model, here with the enhanced one's beta
        // (Khomutenko et al. 2016).
        let alpha = camera.distortion.x;
        let beta = camera.distortion.y;
        let depth = camera.distortion.z + cos(theta);
        let side = sin(theta);
        return side / (alpha * sqrt(beta * side * side + depth * depth) + (1.0 - alpha) * depth);
    }
    if camera.position_m.w > 1.5 {
        // Equisolid (Miyamoto 1964).
        return 2.0 * sin(0.5 * theta);
    }
    // Kannala and Brandt 2006, as OpenCV's fisheye model.
    let t2 = theta * theta;
    let k = camera.distortion;
    return theta * (1.0 + t2 * (k.x + t2 * (k.y + t2 * (k.z + t2 * k.w))));
}

// Distorted normalised image coordinates of a point in the camera frame (z > 0 for a perspective lens), clamped to the lens's
// usable region so that far-off vertices stay off the picture instead of folding back into it.
fn distorted(camera: Camera, point: vec3f) -> vec2f {
    if is_fisheye(camera) {
        let rho = max(length(point.xy), 1e-12);
        return point.xy * (fisheye_radius(camera, min(atan2(rho, point.z), camera.limits.y)) / rho);
    }
    // Brown and Conrady's model as OpenCV writes it, and its rational one.
    let ideal = point.xy / point.z;
    let radius = length(ideal);
    let xy = ideal * min(1.0, camera.limits.y / max(radius, 1e-12));
    let r2 = dot(xy, xy);
    let k = camera.distortion;
    let d = camera.denominator;
    let radial = (1.0 + r2 * (k.x + r2 * (k.y + r2 * camera.limits.x))) / (1.0 + r2 * (d.x + r2 * (d.y + r2 * d.z)));
    let tangential = vec2f(
        2.0 * k.z * xy.x * xy.y + k.w * (r2 + 2.0 * xy.x * xy.x),
        k.z * (r2 + 2.0 * xy.y * xy.y) + 2.0 * k.w * xy.x * xy.y,
    );
    // Beyond the usable radius the picture goes on in a straight line.
    return xy * radial + tangential + (ideal - xy);
}

// Pixel of a point in the camera frame.
fn pixel_of(camera: Camera, point: vec3f) -> vec2f {
    return camera.focal_and_principal_px.xy * distorted(camera, point) + camera.focal_and_principal_px.zw;
}

// Whether the lens images a point in the camera frame at all.
fn is_imaged(camera: Camera, point: vec3f) -> bool {
    if is_fisheye(camera) {
        return atan2(length(point.xy), point.z) < camera.limits.y;
    }
    return point.z > 1e-6 && length(point.xy) < camera.limits.y * point.z;
}

// Clip coordinates of a point in the world: the lens's own pixel, perspective-correct, depth from near to far.
fn clip_of(camera: Camera, point_world: vec3f) -> vec4f {
    let point = (camera.camera_from_world * vec4f(point_world, 1.0)).xyz;
    let near = camera.vignetting_and_depth.z;
    let far = camera.vignetting_and_depth.w;
    let depth = far * (point.z - near) / (far - near);
    var ndc_times_z: vec2f;
    let size = camera.limits.zw;
    if point.z > 0.5 * near {
        let pixel = pixel_of(camera, point);
        ndc_times_z = ((pixel + 0.5) / size * 2.0 - 1.0) * point.z;
    } else {
        // Behind the camera the lens model means nothing; a pinhole lets the clipper cut edges that cross the plane.
        let pinhole = camera.focal_and_principal_px.xy * point.xy + camera.focal_and_principal_px.zw * point.z;
        ndc_times_z = (pinhole + 0.5 * point.z) / size * 2.0 - point.z;
    }
    return vec4f(ndc_times_z.x, -ndc_times_z.y, depth, point.z);
}

// Relative illumination at a pixel: V = 1 + v1 r² + v2 r⁴, r over half the picture's diagonal.
fn vignetting(camera: Camera, pixel: vec2f) -> f32 {
    let size = camera.limits.zw;
    let offset = pixel - 0.5 * (size - 1.0);
    let r2 = dot(offset, offset) / (0.25 * dot(size, size));
    return 1.0 + r2 * (camera.vignetting_and_depth.x + r2 * camera.vignetting_and_depth.y);
}

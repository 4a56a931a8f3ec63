"""Lenses from the same corners by several programs; see bench-calibration.sh.

Error over the field: mrcal's projection difference. At 40 x 30 pixels of the true lens the point that each shows, at infinity or
at the board's distance, is projected with the lens found, after the rotation (and, at a distance, the translation) that fits
best over the whole picture; the rms of the lengths that are left, in pixels.
"""

import argparse
import json
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

import numpy as np

try:
    import cv2
except ImportError:
    cv2 = None

COLUMNS, ROWS, SIDE_M, SPACING_M = 6, 6, 0.088, 0.0264
BOARD = f"""kind = "aprilgrid"
family = "tag36h11"
columns = {COLUMNS}
rows = {ROWS}
side_m = {SIDE_M}
spacing_m = {SPACING_M}
border_bits = 2
"""
CHESSBOARD = 'kind = "chessboard"\ncolumns = 9\nrows = 6\nsquare_m = 0.03\n'

PINHOLE = dict(
    model="brown_conrady", size=(1280, 720), max_angle=np.pi / 2, distance=(0.5, 1.2),
    parameters=np.array([905.3, 903.1, 648.2, 351.7, -0.21, 0.08, 7e-4, -5e-4, -0.012]),
)
FISHEYE = dict(
    model="kannala_brandt", size=(1280, 960), max_angle=np.radians(94.5), distance=(0.3, 0.6),
    parameters=np.array([281.4, 280.9, 645.1, 474.2, 0.012, -0.0081, 0.0022, -0.0004]),
)


def project(model, parameters, points):
    """Pixels of points in the camera frame (OpenCV's formulas)."""
    fx, fy, cx, cy = parameters[:4]
    k = parameters[4:]
    if model == "brown_conrady":
        x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
        s = x * x + y * y
        radial = 1 + s * (k[0] + s * (k[1] + s * k[4]))
        u = x * radial + 2 * k[2] * x * y + k[3] * (s + 2 * x * x)
        v = y * radial + k[2] * (s + 2 * y * y) + 2 * k[3] * x * y
    else:
        rho = np.hypot(points[:, 0], points[:, 1])
        angle = np.arctan2(rho, points[:, 2])
        s = angle * angle
        radius = angle * (1 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))))
        scale = radius / np.maximum(rho, 1e-12)
        u, v = points[:, 0] * scale, points[:, 1] * scale
    return np.stack([fx * u + cx, fy * v + cy], axis=1)


def rays(camera, columns=40, rows=30):
    """Unit rays of a grid of pixels, by Newton's method on numeric derivatives, and their angles to the axis."""
    width, height = camera["size"]
    grid = np.stack(np.meshgrid((np.arange(columns) + 0.5) * width / columns - 0.5,
                                (np.arange(rows) + 0.5) * height / rows - 0.5), axis=-1).reshape(-1, 2)
    parameters = camera["parameters"]
    fisheye = camera["model"] == "kannala_brandt"
    plane = (grid - parameters[2:4]) / parameters[:2]

    def direction(plane):
        if not fisheye:
            return np.concatenate([plane, np.ones((len(plane), 1))], axis=1)
        angle = np.linalg.norm(plane, axis=1, keepdims=True)
        return np.concatenate([plane * np.sinc(angle / np.pi), np.cos(angle)], axis=1)

    def pixel(plane):
        return project(camera["model"], parameters, direction(plane))

    for _ in range(30):
        off = pixel(plane) - grid
        columns_ = [(pixel(plane + step) - pixel(plane - step)) / 2e-6 for step in (np.array([1e-6, 0]), np.array([0, 1e-6]))]
        jacobian = np.stack(columns_, axis=2)
        plane = plane - np.linalg.solve(jacobian, off[:, :, None])[:, :, 0]
    found = direction(plane)
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    angle = np.arccos(np.clip(found[:, 2], -1, 1))
    good = (np.linalg.norm(pixel(plane) - grid, axis=1) < 1e-6) & (angle < camera["max_angle"])
    return found[good], angle[good]


def rotation(vector):
    angle = np.linalg.norm(vector)
    if angle < 1e-15:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def field_error(camera, parameters, distance, up_to=np.pi):
    """Rms in pixels between the true lens and one found."""
    points, angle = rays(camera)
    points = points * (distance or 1.0)
    truth = project(camera["model"], camera["parameters"], points)
    motion = np.zeros(6 if distance else 3)

    def moved(motion):
        there = points @ rotation(motion[:3]).T
        return project(camera["model"], parameters, there + motion[3:] if distance else there)

    for _ in range(6):
        off = (moved(motion) - truth).ravel()
        steps = np.eye(len(motion)) * 1e-6
        jacobian = np.stack([(moved(motion + s) - moved(motion - s)).ravel() / 2e-6 for s in steps], axis=1)
        motion = motion - np.linalg.lstsq(jacobian, off, rcond=None)[0]
    off = np.linalg.norm(moved(motion) - truth, axis=1)[angle <= up_to]
    return float(np.sqrt(np.mean(off**2)))


def board_points(bow_m):
    corners = []
    for row in range(ROWS):
        for column in range(COLUMNS):
            x, y = column * (SIDE_M + SPACING_M), row * (SIDE_M + SPACING_M)
            corners += [(x, y), (x + SIDE_M, y), (x + SIDE_M, y + SIDE_M), (x, y + SIDE_M)]
    flat = np.array(corners)
    half = flat.max(axis=0) / 2
    unit = flat / half - 1
    bent = np.concatenate([flat, (bow_m * (1 - unit[:, :1] ** 2))], axis=1)
    return np.concatenate([flat, np.zeros((len(flat), 1))], axis=1), bent, half


def views(camera, bow_m, sigma, seed, count=40):
    """Corners of a board all over the picture, tilted by up to 57 degrees: [(ids, pixels)]."""
    chance = np.random.default_rng(seed)
    _, bent, half = board_points(bow_m)
    width, height = camera["size"]
    directions, _ = rays(camera)
    result = []
    while len(result) < count:
        towards = directions[chance.integers(len(directions))]
        axis = np.cross([0, 0, 1], -towards)
        length = np.linalg.norm(axis)
        facing = rotation(axis / max(length, 1e-12) * np.arctan2(length, -towards[2]))
        about = chance.uniform(0, 2 * np.pi)
        tilt = np.array([np.cos(about), np.sin(about), 0]) * chance.uniform(0, 1.0)
        turned = facing @ rotation(tilt) @ rotation(np.array([0, 0, chance.uniform(0, 2 * np.pi)]))
        translation = towards * chance.uniform(*camera["distance"]) - turned @ np.array([half[0], half[1], 0])
        points = bent @ turned.T + translation
        angle = np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])
        seen = angle < (camera["max_angle"] if camera["model"] == "kannala_brandt" else np.radians(60))
        pixels = project(camera["model"], camera["parameters"], points)
        seen &= (pixels >= -0.5).all(axis=1) & (pixels[:, 0] < width - 0.5) & (pixels[:, 1] < height - 0.5)
        ids = np.nonzero(seen)[0]
        if len(ids) >= 40 and (turned.T @ -translation)[2] > 0:
            result.append((ids, pixels[ids] + chance.normal(0, sigma, (len(ids), 2))))
    return result


def write_corners(file, size, named):
    views_ = [dict(name=name, corners=[dict(corner=int(i), pixel=[float(x), float(y)]) for i, (x, y) in zip(ids, pixels)])
              for name, (ids, pixels) in named]
    file.write_text(json.dumps(dict(size_px=list(size), views=views_)))


def ours(program, camera, seen, folder):
    (folder / "board.toml").write_text(BOARD)
    write_corners(folder / "corners.json", camera["size"], [(f"{i:03}.png", view) for i, view in enumerate(seen)])
    run = subprocess.run([program, "intrinsics", "--corners", folder / "corners.json", "--board", folder / "board.toml",
                          "--model", camera["model"], "--json", folder / "numbers.json"], capture_output=True, text=True)
    if run.returncode:
        print(run.stderr, file=sys.stderr)
        return None
    return np.array(json.loads((folder / "numbers.json").read_text())["parameters"])


def opencv(camera, seen, _):
    flat, _, _ = board_points(0.0)
    if camera["model"] == "brown_conrady":
        objects = [flat[ids].astype(np.float32).reshape(-1, 1, 3) for ids, _ in seen]
        images = [pixels.astype(np.float32).reshape(-1, 1, 2) for _, pixels in seen]
        criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-12)
        _, matrix, distortion, _, _ = cv2.calibrateCamera(objects, images, camera["size"], None, None, criteria=criteria)
        return np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *distortion.ravel()[:5]])
    objects = [flat[ids].reshape(1, -1, 3) for ids, _ in seen]
    images = [pixels.reshape(1, -1, 2) for _, pixels in seen]
    try:
        return opencv_fisheye(objects, images, camera["size"])[1]
    except cv2.error as error:
        print(f"OpenCV: {str(error).splitlines()[0][:110]}", file=sys.stderr)
        return None


def opencv_fisheye(objects, images, size):
    fisheye = cv2.fisheye
    flags = sum(getattr(fisheye, name, getattr(cv2, f"CALIB_{name[6:]}", 0)) for name in
                ("CALIB_RECOMPUTE_EXTRINSIC", "CALIB_FIX_SKEW", "CALIB_USE_INTRINSIC_GUESS"))
    matrix = np.array([[0.3 * size[0], 0, size[0] / 2], [0, 0.3 * size[0], size[1] / 2], [0, 0, 1.0]])
    distortion = np.zeros((4, 1))
    rms, *_ = fisheye.calibrate(objects, images, size, matrix, distortion, flags=flags, criteria=(3, 200, 1e-12))
    return rms, np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *distortion.ravel()])


def mrcal(camera, seen, folder):
    """mrcal knows boards with one spacing only, so it gets the lower-left corners of all markers, a quarter of all corners.

    It is run with and without its search for outliers, and the better counts. On some bowed boards the search throws out a large part
    of the corners, after which the normal matrix is singular, and without it the rms ends at several pixels; perhaps views start in the
    wrong one of a plane's two poses. Both is a failure.
    """
    program = shutil.which("mrcal-calibrate-cameras")
    lines = ["# filename x y level"]
    for index, (ids, pixels) in enumerate(seen):
        places = {int(i): pixel for i, pixel in zip(ids, pixels)}
        for marker in range(COLUMNS * ROWS):
            pixel = places.get(4 * marker)
            lines.append(f"{index:03}.png - - -" if pixel is None else f"{index:03}.png {pixel[0]:.9f} {pixel[1]:.9f} 0")
    (folder / "corners.vnl").write_text("\n".join(lines) + "\n")
    width, height = camera["size"]
    tries = [mrcal_once([program, *options], camera, folder) for options in ([], ["--skip-outlier-rejection"])]
    rms, intrinsics = min(tries, key=lambda one: one[0])
    # Its figure has one decimal.
    if rms > 0.5:
        print(f"mrcal: no solution (rms {rms} px)", file=sys.stderr)
        return None
    return intrinsics


def mrcal_once(command, camera, folder):
    """Rms and parameters; an infinite rms when it fails."""
    width, height = camera["size"]
    for model in folder.glob("*.cameramodel"):
        model.unlink()
    run = subprocess.run(
        [*command, "--corners-cache", "corners.vnl", "--lensmodel", "LENSMODEL_OPENCV5", "--focal", "900", "--object-spacing",
         str(SIDE_M + SPACING_M), "--object-width-n", str(COLUMNS), "--imagersize", str(width), str(height), "*.png"],
        capture_output=True, text=True, cwd=folder)
    models = list(folder.glob("*.cameramodel"))
    if run.returncode or not models:
        return np.inf, None
    rms = float(re.search(r"RMS reprojection error: ([0-9.]+)", run.stdout).group(1))
    numbers = re.search(r"'intrinsics':\s*\[([^\]]*)\]", models[0].read_text())
    return rms, np.array([float(x) for x in numbers.group(1).replace("\n", " ").split(",") if x.strip()])


def synthetic(arguments):
    cases = [("pinhole, flat board", PINHOLE, 0.0), ("pinhole, board bowed by 1 mm", PINHOLE, 0.001),
             ("Kannala-Brandt 189 degrees", FISHEYE, 0.0)]
    solvers = [("mirrorball", lambda *a: ours(arguments.program, *a)), ("OpenCV", opencv), ("mrcal (a quarter of the corners)", mrcal)]
    print(versions())
    print(f"rms over the field in px, median of {arguments.seeds} cameras; 40 views, corner noise {arguments.sigma} px\n")
    print("| case | solver | at infinity | at the board's distance |\n| --- | --- | --- | --- |")
    for name, camera, bow_m in cases:
        for solver, solve in solvers:
            if solver.startswith("mrcal") and (camera is FISHEYE or not shutil.which("mrcal-calibrate-cameras")):
                continue
            if solver == "OpenCV" and cv2 is None:
                continue
            errors = []
            for seed in range(1, arguments.seeds + 1):
                seen = views(camera, bow_m, arguments.sigma, seed)
                with tempfile.TemporaryDirectory() as folder:
                    parameters = solve(camera, seen, pathlib.Path(folder))
                if parameters is not None:
                    errors.append(row(camera, parameters))
            # A program that fails on a camera has no median over all of them.
            if len(errors) == arguments.seeds:
                print(f"| {name} | {solver} | {' | '.join(np.median(np.array(errors), axis=0).round(4).astype(str))} |"
                      if camera is PINHOLE else
                      f"| {name} | {solver} | to 86°: {np.median([e[0] for e in errors]):.4f}, to 94°: "
                      f"{np.median([e[1] for e in errors]):.4f} | |", flush=True)
            else:
                print(f"| {name} | {solver} | {arguments.seeds - len(errors)} of {arguments.seeds} failed | |", flush=True)


def versions():
    mrcal_program = shutil.which("mrcal-calibrate-cameras")
    mrcal_version = "not installed"
    if mrcal_program is not None:
        mrcal_version = subprocess.run([mrcal_program, "--version"], capture_output=True, text=True).stdout.strip() or "installed"
    return f"OpenCV {'not installed' if cv2 is None else cv2.__version__}, mrcal {mrcal_version}"


def row(camera, parameters):
    if camera is PINHOLE:
        return field_error(camera, parameters, None), field_error(camera, parameters, 0.8)
    return tuple(field_error(camera, parameters, None, np.radians(a)) for a in (86, 94))


def photos(arguments):
    """Real pictures: both detectors' corners to both solvers; OpenCV gets the corners that ours believes, so the sets are equal."""
    folder = pathlib.Path(arguments.photos)
    with tempfile.TemporaryDirectory() as scratch:
        scratch = pathlib.Path(scratch)
        (scratch / "board.toml").write_text(CHESSBOARD)
        sets = []
        subprocess.run([arguments.program, "intrinsics", "--images", folder, "--board", scratch / "board.toml", "--model",
                        "kannala_brandt", "--corners-out", scratch / "ours.json"], capture_output=True)
        if (scratch / "ours.json").exists():
            sets.append(("mirrorball", scratch / "ours.json"))
        if cv2 is not None:
            opencv_corners(folder, scratch / "opencv.json")
            sets.append(("OpenCV", scratch / "opencv.json"))
        print("\n| corners of | views | corners | solver | rms px |\n| --- | --- | --- | --- | --- |")
        for name, file in sets:
            photo_rows(arguments, scratch, name, file)


def opencv_corners(folder, file):
    found, size = [], None
    for picture in sorted(folder.glob("*.png")):
        grey = cv2.imread(str(picture), 0)
        size = grey.shape[::-1]
        flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
        ok, corners = cv2.findChessboardCornersSB(grey, (9, 6), flags=flags)
        if ok:
            # OpenCV's rows run from the top, ours from the bottom.
            found.append((picture.name, (np.arange(54), corners.reshape(6, 9, 2)[::-1].reshape(-1, 2))))
    write_corners(file, size, found)


def photo_rows(arguments, scratch, name, file):
    corners = json.loads(file.read_text())
    count = sum(len(view["corners"]) for view in corners["views"])
    run = subprocess.run([arguments.program, "intrinsics", "--corners", file, "--board", scratch / "board.toml", "--model",
                          "kannala_brandt", "--json", scratch / "numbers.json"], capture_output=True, text=True)
    if run.returncode:
        print(run.stderr, file=sys.stderr)
        return
    numbers = json.loads((scratch / "numbers.json").read_text())
    kept = believed(corners, numbers)
    used = sum(len(view) for view in kept)
    print(f"| {name} | {len(kept)} | {used} of {count} | mirrorball | {numbers['rms_px']:.4f} |")
    if cv2 is None:
        return
    objects = [np.array([[(i % 9) * 0.03, (i // 9) * 0.03, 0.0] for i, _ in view]).reshape(1, -1, 3) for view in kept]
    images = [np.array([pixel for _, pixel in view]).reshape(1, -1, 2) for view in kept]
    rms, _ = opencv_fisheye(objects, images, tuple(corners["size_px"]))
    print(f"| {name} | {len(kept)} | {used} of {count} | OpenCV {cv2.__version__} | {rms:.4f} |")


def believed(corners, numbers):
    """The corners that took part: a list of (corner, pixel) for each view."""
    views_ = {view["name"] for view in numbers["views"]}
    out = {(corner["view"], corner["corner"]) for corner in numbers["rejected_corners"]}
    return [[(c["corner"], c["pixel"]) for c in view["corners"] if (view["name"], c["corner"]) not in out]
            for view in corners["views"] if view["name"] in views_]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--program", required=True)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--sigma", type=float, default=0.05)
    parser.add_argument("--photos")
    arguments = parser.parse_args()
    synthetic(arguments)
    if arguments.photos:
        photos(arguments)


if __name__ == "__main__":
    main()

//! The page as a real browser shows it: Chromium without a window, by its screenshot and the tree it made of the page.
//!
//! Skipped where there is no Chromium, unless `MIRRORBALL_REQUIRE_CHROMIUM` is set.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
};

use image::{Rgb, RgbImage};
use mirrorball_calib::report::{
    Block, Plot, Report,
    plot::{Axis, Series, Style},
};

/// Chromium as Debian calls it, and as others do.
const NAMES: [&str; 3] = ["chromium", "chromium-browser", "google-chrome"];

/// Colours of the page's style sheet: of the first and second series, and of the paper.
const BRIGHT: Colours = Colours {
    first: [0x00, 0x72, 0xb2],
    second: [0xd5, 0x5e, 0x00],
    paper: [0xff, 0xff, 0xff],
};
const DARK: Colours = Colours {
    first: [0x56, 0xb4, 0xe9],
    second: [0xff, 0x8f, 0x4d],
    paper: [0x14, 0x17, 0x1a],
};

struct Colours {
    first: [u8; 3],
    second: [u8; 3],
    paper: [u8; 3],
}

/// The browser, or a word that there is none.
fn chromium() -> Option<PathBuf> {
    let folders = env::var_os("PATH").unwrap_or_default();
    let found = env::split_paths(&folders)
        .flat_map(|folder| NAMES.map(|name| folder.join(name)))
        .find(|file| file.is_file());
    if found.is_none() {
        assert!(
            env::var_os("MIRRORBALL_REQUIRE_CHROMIUM").is_none(),
            "no chromium, but MIRRORBALL_REQUIRE_CHROMIUM is set"
        );
        eprintln!("SKIPPED: no chromium");
    }
    found
}

/// What Chromium says (its output, its log) when it opens a page with these options.
fn browse(chromium: &Path, page: &Path, options: &[&str]) -> (String, String) {
    let profile = tempfile::tempdir().expect("a temporary folder");
    let output = Command::new(chromium)
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--no-first-run",
        ])
        .args([
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
        ])
        .args([
            "--disable-dev-shm-usage",
            "--hide-scrollbars",
            "--enable-logging=stderr",
            "--log-level=0",
        ])
        .arg(format!("--user-data-dir={}", profile.path().display()))
        .args(options)
        .arg(format!("file://{}", page.display()))
        .output()
        .expect("chromium starts");
    let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    let (out, log) = (text(output.stdout), text(output.stderr));
    assert!(output.status.success(), "{log}");
    (out, log)
}

fn screenshot(chromium: &Path, page: &Path, size: [u32; 2], options: &[&str]) -> RgbImage {
    let file = page.with_extension("png");
    let (target, window) = (
        format!("--screenshot={}", file.display()),
        format!("--window-size={},{}", size[0], size[1]),
    );
    let (_, log) = browse(chromium, page, &[&[target.as_str(), &window], options].concat());
    let complaints: Vec<&str> = log.lines().filter(|line| line.contains("CONSOLE")).collect();
    assert!(complaints.is_empty(), "{complaints:?}");
    image::open(file).expect("a screenshot").into_rgb8()
}

/// A page with one of everything.
fn page() -> Report {
    let mut report = Report::new("Lens of `scene`");
    report
        .push(Block::Text(
            "40 views of an AprilGrid, 5760 corners, of which 12 were left out as outliers. The board is bowed by 0.98 mm.".to_owned(),
        ))
        .push(Block::Warning(
            "no view is near the upper right corner: σ there is 0.4 px. Take pictures with the board in that corner.".to_owned(),
        ))
        .push(Block::Heading("Lens".to_owned()))
        .push(Block::Table {
            caption: "Parameters with their standard deviations".to_owned(),
            head: ["parameter", "value", "σ"].map(str::to_owned).to_vec(),
            rows: [
                ["fx, px", "605.512", "0.021"],
                ["fy, px", "605.004", "0.022"],
                ["cx, px", "320.91", "0.03"],
                ["k1", "-0.0621", "0.0004"],
            ]
            .map(|row| row.map(str::to_owned).to_vec())
            .to_vec(),
        })
        .push(Block::Heading("Response".to_owned()))
        .push(response())
        .push(convergence())
        .push(Block::Heading("Residuals".to_owned()))
        .push(residuals())
        .push(Block::Heading("Uncertainty".to_owned()))
        .push(uncertainty())
        .push(Block::Heading("Colour".to_owned()))
        .push(patches())
        .push(picture());
    report
}

fn chart(caption: &str, [x, y]: [Axis; 2], series: Vec<Series>) -> Block {
    Block::Plot {
        caption: caption.to_owned(),
        plot: Plot::Chart { x, y, series },
    }
}

fn series(name: &str, style: Style, points: impl Iterator<Item = [f64; 2]>) -> Series {
    Series {
        name: name.to_owned(),
        points: points.collect(),
        style,
    }
}

fn response() -> Block {
    let codes = || (0..256).map(f64::from);
    let linear = |code: f64| (code / 255.0).powf(2.2);
    let measured = codes()
        .step_by(6)
        .map(|code| [code, linear(code) * (1.0 + 0.06 * (code * 1.7).sin())]);
    chart(
        "Response curve: measured dots should lie on the line",
        [Axis::linear("code"), Axis::linear("linear signal, of full")],
        vec![
            series("fitted", Style::Line, codes().map(|code| [code, linear(code)])),
            series("measured", Style::Dots, measured),
            series(
                "sRGB",
                Style::Dashed,
                codes().map(|code| [code, (code / 255.0).powf(2.4)]),
            ),
        ],
    )
}

fn convergence() -> Block {
    let cost = (1..=12).map(|i| [f64::from(i), 1e5 * (-1.3 * f64::from(i)).exp() + 0.013]);
    chart(
        "Cost after each iteration",
        [Axis::linear("iteration"), Axis::logarithmic("cost")],
        vec![series("", Style::Line, cost)],
    )
}

fn residuals() -> Block {
    let vectors = (0..24 * 18).map(|i| {
        let at = [f64::from(i % 24) * 27.0 + 10.0, f64::from(i / 24) * 27.0 + 10.0];
        (at, [0.12 * (at[1] * 0.02).sin(), 0.1 * (at[0] * 0.03).cos()])
    });
    Block::Plot {
        caption: "Residuals of all corners: neighbours that point the same way say that the model does not fit"
            .to_owned(),
        plot: Plot::Vectors {
            size_px: [640, 480],
            vectors: vectors.collect(),
            scale: 100.0,
        },
    }
}

fn uncertainty() -> Block {
    let values = (0..32 * 24).map(|i| {
        let (x, y) = (f64::from(i % 32) / 31.0 - 0.4, f64::from(i / 32) / 23.0 - 0.6);
        if i == 31 {
            f64::NAN
        } else {
            0.01 + 0.4 * (x * x + y * y)
        }
    });
    Block::Plot {
        caption: "How far a projected point may be off, at infinity".to_owned(),
        plot: Plot::HeatMap {
            size_px: [640, 480],
            columns: 32,
            values: values.collect(),
            value: Axis::linear("σ, px"),
        },
    }
}

fn patches() -> Block {
    let row = |name: &str, rgb: [f64; 3]| {
        let off = [rgb[0] * 1.1, rgb[1] * 0.95, rgb[2]];
        (name.to_owned(), vec![off, rgb.map(|c| c * 1.01), rgb])
    };
    Block::Plot {
        caption: "Patches as the second camera sees them, corrected, and as the first one does".to_owned(),
        plot: Plot::Patches {
            columns: ["measured", "corrected", "wanted"].map(str::to_owned).to_vec(),
            rows: vec![
                row("dark skin", [0.45, 0.32, 0.27]),
                row("blue sky", [0.38, 0.48, 0.62]),
                row("pure red", [1.0, 0.0, 0.0]),
            ],
        },
    }
}

fn picture() -> Block {
    let picture = RgbImage::from_fn(320, 120, |x, y| Rgb([(x / 2) as u8, (2 * y) as u8, 128]));
    let mut png = Vec::new();
    picture
        .write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png)
        .expect("memory takes everything");
    Block::Picture {
        caption: "A view".to_owned(),
        png,
    }
}

/// Pixels of nearly this colour.
fn count(picture: &RgbImage, colour: [u8; 3]) -> usize {
    let is_near = |pixel: &Rgb<u8>| pixel.0.iter().zip(colour).all(|(a, b)| a.abs_diff(b) <= 6);
    picture.pixels().filter(|pixel| is_near(pixel)).count()
}

#[test]
fn a_browser_shows_the_page() {
    let Some(chromium) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("report.html");
    fs::write(&file, page().to_html()).unwrap();
    let size = [900, 4300];
    for (colours, options) in [(BRIGHT, &[][..]), (DARK, &["--blink-settings=preferredColorScheme=0"])] {
        let picture = screenshot(&chromium, &file, size, options);
        // To be looked at.
        if let Some(folder) = env::var_os("MIRRORBALL_SCREENSHOTS") {
            let name = if options.is_empty() { "bright.png" } else { "dark.png" };
            picture.save(Path::new(&folder).join(name)).unwrap();
        }
        let all = (size[0] * size[1]) as usize;
        assert_eq!(picture.dimensions(), (size[0], size[1]));
        assert!(count(&picture, colours.paper) > all / 2, "mostly paper");
        // A curve of 600 pixels and two wide; dots and arrows.
        assert!(
            count(&picture, colours.first) > 1000,
            "{}",
            count(&picture, colours.first)
        );
        assert!(
            count(&picture, colours.second) > 500,
            "{}",
            count(&picture, colours.second)
        );
        // The ends of the colour scale in its bar, a patch, the picture.
        assert!(count(&picture, [0x44, 0x01, 0x54]) > 50);
        assert!(count(&picture, [0xfd, 0xe7, 0x25]) > 50);
        assert!(count(&picture, [0xff, 0x00, 0x00]) > 2000, "the wanted patch");
        assert!(count(&picture, [0x50, 0x78, 0x80]) > 10, "the picture");
        // Nothing reaches the margins.
        let margin = (0..size[1]).all(|y| {
            [0, 5, size[0] - 6, size[0] - 1]
                .iter()
                .all(|x| picture.get_pixel(*x, y).0 == colours.paper)
        });
        assert!(margin, "something sticks out of the page");
    }
}

#[test]
fn a_narrow_window_cuts_nothing_off() {
    let Some(chromium) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("report.html");
    // A script of the test's own, which the page's policy would not let run, writes down what sticks out.
    let measure = "<script>document.documentElement.dataset.widths = \
                   document.documentElement.scrollWidth + ' ' + window.innerWidth;</script></body>";
    let html = page().to_html();
    let policy = html.find("<meta http-equiv").expect("a policy");
    let end = policy + html[policy..].find('>').expect("an end") + 1;
    let html = format!("{}{}", &html[..policy], &html[end..]).replacen("</body>", measure, 1);
    fs::write(&file, html).unwrap();
    for width in [500, 900, 1600] {
        let window = format!("--window-size={width},900");
        let (tree, _) = browse(&chromium, &file, &["--dump-dom", &window]);
        let widths = tree
            .split("data-widths=\"")
            .nth(1)
            .and_then(|rest| rest.split('"').next());
        let widths: Vec<u32> = widths
            .expect("measured")
            .split(' ')
            .map(|text| text.parse().unwrap())
            .collect();
        assert!(widths[0] <= widths[1], "{widths:?}");
        assert_eq!(tree.matches("<svg").count(), html_svgs(), "every drawing is there");
    }
}

/// Drawings on the page, those of legends and one inside another included.
fn html_svgs() -> usize {
    page().to_html().matches("<svg").count()
}

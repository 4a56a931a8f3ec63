use super::spots::cosine_directions;
use super::*;
use crate::probe::clipped::Price;

const PROBE_M: Vec3 = Vec3::new(0.2, 0.1, 0.05);
const AMBIENT: f32 = 0.3;

/// A lamp far above the clipping level, 2° in radius.
#[derive(Clone, Copy)]
struct Lamp {
    direction: Vec3,
    distance_m: f32,
    /// Power per solid angle: irradiance times distance squared.
    intensity: f32,
}

impl Lamp {
    fn new(direction: Vec3, distance_m: f32, intensity: f32) -> Self {
        Self {
            direction: direction.normalize(),
            distance_m,
            intensity,
        }
    }

    fn position_m(self) -> Vec3 {
        PROBE_M + self.direction * self.distance_m
    }
}

fn spot(position_m: Vec3, normal: Vec3, reflectance: Reflectance) -> Spot {
    Spot {
        position_m,
        normal,
        reflectance,
        places_m: vec![position_m],
        ends_m: [position_m; 2],
        rays: cosine_directions(normal).map(|d| (d, NOTHING_M)).collect(),
    }
}

/// Papers on a sheet and on tilted cards.
fn papers() -> Vec<Spot> {
    let mut papers = Vec::new();
    for x in [-0.25f32, -0.1, 0.1, 0.25] {
        for normal in [Vec3::Z, Vec3::new(0.0, 0.6, 0.8), Vec3::new(0.5, 0.0, 0.866)] {
            papers.push(spot(Vec3::new(x, 0.5 * x, 0.0), normal, Reflectance::Known(0.8)));
        }
    }
    papers
}

/// A table of unknown reflectance, a patch every 8 cm.
fn table() -> Vec<Spot> {
    let place = |k: i32| 0.08 * k as f32;
    (-4..=4)
        .flat_map(|x| (-4..=4).map(move |y| Vec3::new(place(x), place(y), 0.0)))
        .map(|p| spot(p, Vec3::Z, Reflectance::OfPart(0)))
        .collect()
}

fn meter_of(spots: Vec<Spot>) -> LightMeter {
    LightMeter {
        sights: spots.iter().map(|_| Sight::default()).collect(),
        n_always: spots.len(),
        n_parts: 1,
        spots,
        ..LightMeter::default()
    }
}

/// What a camera reads under the lamps: `table_reflectance`, give or take a tenth of texture, for the parts.
fn read(meter: &LightMeter, lamps: &[Lamp], table_reflectance: f32) -> Vec<Reading> {
    let of_spot = |(index, spot): (usize, &Spot)| {
        let from_lamp = |lamp: &Lamp| {
            let to_lamp = lamp.position_m() - spot.position_m;
            lamp.intensity * spot.normal.dot(to_lamp).max(0.0) / to_lamp.length().powi(3)
        };
        let irradiance = PI * AMBIENT + lamps.iter().map(from_lamp).sum::<f32>();
        let reflectance = match spot.reflectance {
            Reflectance::Known(reflectance) => reflectance,
            Reflectance::OfPart(_) => table_reflectance * (1.0 + 0.1 * (7.3 * index as f32).sin()),
        };
        Reading {
            spot: index,
            radiance: Vec3::splat(irradiance * reflectance / PI),
        }
    };
    meter.spots.iter().enumerate().map(of_spot).collect()
}

/// The clipped cube: 1 where a lamp is, the ambient light elsewhere.
fn clipped_cube(lamps: &[Lamp]) -> (Cube<Vec3>, Vec<StrongRegion>) {
    let mut far = Cube::filled(64, Vec3::splat(AMBIENT));
    let mut regions = Vec::new();
    for lamp in lamps {
        let texels: Vec<usize> = (0..far.texels().len())
            .filter(|&i| far.direction(i).dot(lamp.direction) > 2f32.to_radians().cos())
            .collect();
        for &i in &texels {
            far.texels_mut()[i] = Vec3::ONE;
        }
        regions.push(StrongRegion {
            core: texels.clone(),
            texels,
            channels: [true; 3],
            price: Price::NONE,
            beyond: None,
        });
    }
    (far, regions)
}

/// Distances found, and the irradiance that each lamp gives the probe.
fn measure(spots: Vec<Spot>, lamps: &[Lamp]) -> (Vec<f32>, Vec<f32>, MeterFit) {
    let mut meter = meter_of(spots);
    let readings = read(&meter, lamps, 0.35);
    let (far, regions) = clipped_cube(lamps);
    let light = KnownLight {
        probe_m: PROBE_M,
        far: &far,
        radiance: &far,
        room_m: 2.0,
    };
    let question = meter.question(&readings, light, &regions, &Occluders::default());
    let distances = question.distances_m(2.0, &vec![None; lamps.len()]);
    let fit = question.explain(&distances);
    let mut full = far.clone();
    for missing in &fit.missing {
        for &(i, brightness) in &missing.texels {
            full.texels_mut()[i] += brightness * missing.radiance;
        }
    }
    let irradiance = |region: &StrongRegion| {
        let texels = region.texels.iter();
        texels.map(|&i| full.texels()[i].x * full.solid_angle(i)).sum()
    };
    (
        distances.iter().map(|d| d.0).collect(),
        regions.iter().map(irradiance).collect(),
        fit,
    )
}

fn assert_near(found: f32, expected: f32, tolerance: f32) {
    assert!(
        (found / expected - 1.0).abs() < tolerance,
        "{found} instead of {expected}"
    );
}

#[test]
fn a_clipped_lamp_gets_its_energy_and_its_distance_back() {
    let lamp = Lamp::new(Vec3::new(-0.5, 0.4, 0.77), 1.1, 3.0);
    let (distances, irradiances, fit) = measure(papers(), &[lamp]);
    assert_near(distances[0], 1.1, 0.05);
    assert_near(irradiances[0], 3.0 / (1.1 * 1.1), 0.05);
    assert!(fit.residual < 0.02 && fit.papers == 12, "{}", fit.residual);
}

#[test]
fn two_lamps_have_their_own_distances() {
    let lamps = [
        Lamp::new(Vec3::new(-0.7, 0.3, 0.6), 0.9, 3.0),
        Lamp::new(Vec3::new(0.6, 0.5, 0.8), 1.7, 8.0),
    ];
    let mut spots = papers();
    spots.extend(table());
    let (distances, irradiances, _) = measure(spots, &lamps);
    for (k, lamp) in lamps.iter().enumerate() {
        assert_near(distances[k], lamp.distance_m, 0.1);
        assert_near(irradiances[k], lamp.intensity / lamp.distance_m.powi(2), 0.1);
    }
}

#[test]
fn a_table_of_unknown_reflectance_tells_the_distance_that_one_sheet_cannot() {
    let lamp = Lamp::new(Vec3::new(-0.5, 0.4, 0.77), 1.2, 3.0);
    let sheet = || {
        let place = |k: i32| Vec3::new(0.01 * k as f32, 0.0, 0.0);
        (0..4).map(move |k| spot(place(k), Vec3::Z, Reflectance::Known(0.8)))
    };
    let mut spots: Vec<Spot> = sheet().collect();
    spots.extend(table());
    let (distances, irradiances, fit) = measure(spots, &[lamp]);
    assert_near(distances[0], 1.2, 0.1);
    assert_near(irradiances[0], 3.0 / (1.2 * 1.2), 0.1);
    assert_eq!((fit.papers, fit.patches), (4, 81));
    // The sheet alone leaves it at the room's.
    let (alone, _, _) = measure(sheet().collect(), &[lamp]);
    assert!((alone[0] - 1.2).abs() > 0.3, "{alone:?}");
}

#[test]
fn without_papers_nothing_is_missing() {
    let lamp = Lamp::new(Vec3::Z, 1.2, 3.0);
    let (distances, _, fit) = measure(table(), &[lamp]);
    assert_eq!(distances, [2.0]);
    assert_eq!(fit.papers, 0);
    let (none, _, _) = measure(Vec::new(), &[lamp]);
    assert_eq!(none, [2.0]);
}

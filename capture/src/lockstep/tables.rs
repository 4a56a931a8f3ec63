//! What a camera's control values mean: calibrated tables of one camera, and their form in a configuration file.
//!
//! Exposure times and gains are interpolated linearly between the points of a table; white-balance gains linearly in
//! their logarithm over the reciprocal temperature (mired), over which the colour of light changes evenly. A table
//! never reaches past its ends: values beyond them are not used.

use serde::Deserialize;

/// Seconds per step of the exposure control of UVC cameras and of `V4L2_CID_EXPOSURE_ABSOLUTE`.
pub const EXPOSURE_UNIT_S: f64 = 1e-4;

/// Most points a table may have.
pub const POINTS_MAX: usize = 1024;

/// Exposure control to time; every key is optional.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExposureTableConfig {
    /// Seconds per step of the control, above 0 to 1; without `points` the time is the control's value times this.
    pub unit_s: Option<f64>,
    /// Pairs of control value and seconds really exposed, both rising.
    pub points: Option<Vec<(i64, f64)>>,
}

/// Gain control to linear gain.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GainTableConfig {
    /// Pairs of control value and linear gain, both rising.
    pub points: Vec<(i64, f64)>,
}

/// White-balance controls to gains: `temperatures`, or `red` and `blue`.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WhiteBalanceTableConfig {
    /// Colour temperature in kelvin and the linear gains of red, green and blue then in force; the temperature rises,
    /// and with it the ratio of red to blue.
    pub temperatures: Option<Vec<(i64, [f64; 3])>>,
    /// Pairs of red balance and linear gain of red, both rising.
    pub red: Option<Vec<(i64, f64)>>,
    /// Pairs of blue balance and linear gain of blue, both rising.
    pub blue: Option<Vec<(i64, f64)>>,
}

/// Relative signal by the colour of the light: channels of different cameras see differently much of each other's
/// colours, so one ratio does not fit all light.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensitivityTableConfig {
    /// Colour temperature of the light in kelvin, rising, and the signal of red, green and blue that a grey thing then
    /// gives, relative to the other cameras of the rig.
    pub temperatures: Vec<(i64, [f64; 3])>,
}

/// All tables of one camera.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TablesConfig {
    /// Exposure control; without it [`EXPOSURE_UNIT_S`] per step.
    pub exposure_table: Option<ExposureTableConfig>,
    /// Gain control; without it the gain is left alone and taken as 1.
    pub gain_table: Option<GainTableConfig>,
    /// White-balance controls; without it temperatures are taken as those of a black body seen by a camera with the
    /// primaries of ITU-R BT.709, and red and blue balance are left alone.
    pub white_balance_table: Option<WhiteBalanceTableConfig>,
    /// Signal of red, green and blue relative to the other cameras of the rig, 0.01 to 100, in any light; 1 without it.
    pub sensitivity: Option<[f64; 3]>,
    /// The same where it depends on the light; instead of `sensitivity`.
    pub sensitivity_table: Option<SensitivityTableConfig>,
}

/// Why a table cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TableError {
    /// Too few or too many points.
    #[error("`{table}` has `{found}` points (allowed: 2 to {POINTS_MAX})")]
    Points {
        /// The key of the table.
        table: &'static str,
        /// Points found.
        found: usize,
    },
    /// A number is out of range.
    #[error("`{table}` has `{found}` (allowed: {allowed})")]
    Value {
        /// The key of the table.
        table: &'static str,
        /// The value found.
        found: f64,
        /// What would be right.
        allowed: &'static str,
    },
    /// Values or what they stand for do not rise.
    #[error("`{table}` does not rise at control value `{value}` (allowed: values and what they stand for both rising)")]
    NotRising {
        /// The key of the table.
        table: &'static str,
        /// Control value of the point that is too low.
        value: i64,
    },
    /// Both kinds of a table, or half of one.
    #[error("`{table}` has {found} (allowed: {allowed})")]
    Kinds {
        /// The key of the table.
        table: &'static str,
        /// What there is.
        found: &'static str,
        /// What would be right.
        allowed: &'static str,
    },
}

impl TableError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> &'static str {
        match self {
            Self::Points { .. } => "give the two ends of the control's range at least",
            Self::Value { .. } => "times are in seconds, gains are linear (not dB), temperatures in kelvin",
            Self::NotRising { .. } => "sort the points; leave out the part where the camera answers no more",
            Self::Kinds { .. } => "use the one kind that was calibrated",
        }
    }
}

/// A rising function of a control's value, linear between points.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    points: Vec<(i64, f64)>,
}

impl Curve {
    fn new(table: &'static str, points: &[(i64, f64)], allowed: (f64, f64, &'static str)) -> Result<Self, TableError> {
        let (least, greatest, allowed) = allowed;
        if !(2..=POINTS_MAX).contains(&points.len()) {
            let found = points.len();
            return Err(TableError::Points { table, found });
        }
        if let Some(&(_, found)) = points.iter().find(|(_, y)| !(*y >= least && *y <= greatest)) {
            return Err(TableError::Value { table, found, allowed });
        }
        if let Some(pair) = points
            .windows(2)
            .find(|pair| pair[1].0 <= pair[0].0 || pair[1].1 <= pair[0].1)
        {
            let value = pair[1].0;
            return Err(TableError::NotRising { table, value });
        }
        Ok(Self {
            points: points.to_vec(),
        })
    }

    /// First and last control value.
    #[must_use]
    pub fn span(&self) -> (i64, i64) {
        (self.points[0].0, self.points[self.points.len() - 1].0)
    }

    /// What a control value stands for; past the ends that of the nearer end.
    #[must_use]
    pub fn at(&self, value: i64) -> f64 {
        let after = self.points.partition_point(|point| point.0 <= value);
        let Some(before) = after.checked_sub(1) else {
            return self.points[0].1;
        };
        let (x0, y0) = self.points[before];
        let Some(&(x1, y1)) = self.points.get(after) else {
            return y0;
        };
        y0 + (y1 - y0) * ((value - x0) as f64 / (x1 - x0) as f64)
    }

    /// The control value, with a fraction, that stands for `y`; past the ends the nearer end.
    #[must_use]
    pub fn value_for(&self, y: f64) -> f64 {
        let after = self.points.partition_point(|point| point.1 <= y);
        let Some(before) = after.checked_sub(1) else {
            return self.points[0].0 as f64;
        };
        let (x0, y0) = self.points[before];
        let Some(&(x1, y1)) = self.points.get(after) else {
            return x0 as f64;
        };
        x0 as f64 + (x1 - x0) as f64 * ((y - y0) / (y1 - y0))
    }
}

/// Exposure control to seconds.
#[derive(Debug, Clone, PartialEq)]
pub enum ExposureTable {
    /// So many seconds per step.
    Unit(f64),
    /// Measured.
    Measured(Curve),
}

impl ExposureTable {
    /// Seconds exposed at a control value, above 0.
    #[must_use]
    pub fn time_s(&self, value: i64) -> f64 {
        match self {
            Self::Unit(unit_s) => value.max(1) as f64 * unit_s,
            Self::Measured(curve) => curve.at(value),
        }
    }

    /// The control value, with a fraction, for so many seconds.
    #[must_use]
    pub fn value_for(&self, time_s: f64) -> f64 {
        match self {
            Self::Unit(unit_s) => time_s / unit_s,
            Self::Measured(curve) => curve.value_for(time_s),
        }
    }

    /// First and last control value that the table speaks about.
    #[must_use]
    pub fn span(&self) -> (i64, i64) {
        match self {
            Self::Unit(_) => (1, i64::MAX),
            Self::Measured(curve) => curve.span(),
        }
    }
}

/// White-balance controls to gains.
#[derive(Debug, Clone, PartialEq)]
pub enum WhiteBalanceTable {
    /// One control, a colour temperature.
    Temperature(TemperatureTable),
    /// A control for red and one for blue; green is 1.
    RedBlue {
        /// Red balance to linear gain.
        red: Curve,
        /// Blue balance to linear gain.
        blue: Curve,
    },
}

/// Colour temperature to three gains.
#[derive(Debug, Clone, PartialEq)]
pub struct TemperatureTable {
    /// Kelvin, then log2 of the gains of red, green and blue; at least one, temperatures rising.
    points: Vec<(f64, [f64; 3])>,
}

impl TemperatureTable {
    /// The same gains whatever the temperature.
    #[must_use]
    pub fn constant(gains: [f64; 3]) -> Self {
        Self {
            points: vec![(5000.0, gains.map(f64::log2))],
        }
    }

    fn new(table: &'static str, points: &[(i64, [f64; 3])]) -> Result<Self, TableError> {
        if !(2..=POINTS_MAX).contains(&points.len()) {
            let found = points.len();
            return Err(TableError::Points { table, found });
        }
        for (kelvin, gains) in points {
            check_value(
                table,
                *kelvin as f64,
                (1000.0, 40_000.0),
                "temperatures from 1000 to 40000 K",
            )?;
            for gain in gains {
                check_value(table, *gain, (0.01, 100.0), "linear gains from 0.01 to 100")?;
            }
        }
        if let Some(pair) = points.windows(2).find(|pair| pair[1].0 <= pair[0].0) {
            let value = pair[1].0;
            return Err(TableError::NotRising { table, value });
        }
        Ok(Self {
            points: points
                .iter()
                .map(|(kelvin, gains)| (*kelvin as f64, gains.map(f64::log2)))
                .collect(),
        })
    }

    /// A camera whose channels are the primaries of ITU-R BT.709, balanced to black bodies.
    #[must_use]
    pub fn black_body() -> Self {
        let point = |kelvin: f64| {
            let rgb = black_body_rgb(kelvin);
            (kelvin, rgb.map(|channel| (rgb[1] / channel).log2()))
        };
        let points = [
            2000.0, 2300.0, 2700.0, 3200.0, 3700.0, 4300.0, 5000.0, 5600.0, 6500.0, 7500.0, 9000.0, 12_000.0,
        ];
        Self {
            points: points.map(point).to_vec(),
        }
    }

    /// Lowest and highest temperature in kelvin.
    #[must_use]
    pub fn span_k(&self) -> (f64, f64) {
        (self.points[0].0, self.points[self.points.len() - 1].0)
    }

    /// Linear gains of red, green and blue at a temperature; past the ends those of the nearer end.
    #[must_use]
    pub fn gains(&self, kelvin: f64) -> [f64; 3] {
        let after = self.points.partition_point(|point| point.0 <= kelvin);
        let Some(before) = after.checked_sub(1) else {
            return self.points[0].1.map(f64::exp2);
        };
        let (k0, log0) = self.points[before];
        let Some(&(k1, log1)) = self.points.get(after) else {
            return log0.map(f64::exp2);
        };
        let share = (1.0 / k0 - 1.0 / kelvin) / (1.0 / k0 - 1.0 / k1);
        std::array::from_fn(|channel| (log0[channel] + share * (log1[channel] - log0[channel])).exp2())
    }

    /// Checks that red over blue rises with the temperature, so that [`Self::kelvin_for`] has one answer.
    fn rising(self, table: &'static str) -> Result<Self, TableError> {
        let ratio_log2 = |gains: [f64; 3]| gains[0] - gains[2];
        match self
            .points
            .windows(2)
            .find(|pair| ratio_log2(pair[1].1) <= ratio_log2(pair[0].1))
        {
            None => Ok(self),
            Some(pair) => Err(TableError::NotRising {
                table,
                value: pair[1].0 as i64,
            }),
        }
    }

    /// The temperature in kelvin with this ratio of red to blue gain, in a table where that rises; past the ends the
    /// nearer end.
    #[must_use]
    pub fn kelvin_for(&self, red_over_blue: f64) -> f64 {
        let (mut low, mut high) = self.span_k();
        for _ in 0..32 {
            let kelvin = 0.5 * (low + high);
            let gains = self.gains(kelvin);
            if gains[0] / gains[2] < red_over_blue {
                low = kelvin;
            } else {
                high = kelvin;
            }
        }
        0.5 * (low + high)
    }
}

/// Linear red, green and blue (ITU-R BT.709 primaries) of a black body, green near 1.
///
/// Chromaticity after Kim et al. 2002 (US patent 7024034), cubic in 1/T, good from 1667 to 25000 K; then the matrix of
/// IEC 61966-2-1. Below 1900 K blue would be negative and stops at a hundredth.
fn black_body_rgb(kelvin: f64) -> [f64; 3] {
    let t = 1e3 / kelvin;
    let x = if kelvin <= 4000.0 {
        -0.266_123_9 * t.powi(3) - 0.234_358_9 * t.powi(2) + 0.877_695_6 * t + 0.179_910
    } else {
        -3.025_846_9 * t.powi(3) + 2.107_037_9 * t.powi(2) + 0.222_634_7 * t + 0.240_390
    };
    let y = if kelvin <= 2222.0 {
        -1.106_381_4 * x.powi(3) - 1.348_110_2 * x.powi(2) + 2.185_558_32 * x - 0.202_196_83
    } else if kelvin <= 4000.0 {
        -0.954_947_6 * x.powi(3) - 1.374_185_93 * x.powi(2) + 2.091_370_15 * x - 0.167_488_67
    } else {
        3.081_758 * x.powi(3) - 5.873_386_7 * x.powi(2) + 3.751_129_97 * x - 0.370_014_83
    };
    let (big_x, big_z) = (x / y, (1.0 - x - y) / y);
    [
        3.240_97 * big_x - 1.537_383 - 0.498_611 * big_z,
        -0.969_244 * big_x + 1.875_968 + 0.041_555 * big_z,
        (0.055_63 * big_x - 0.203_977 + 1.056_972 * big_z).max(0.01),
    ]
}

/// All tables of one camera, checked.
#[derive(Debug, Clone, PartialEq)]
pub struct Tables {
    /// Exposure control to seconds.
    pub exposure: ExposureTable,
    /// Gain control to linear gain; none if nobody knows.
    pub gain: Option<Curve>,
    /// White-balance controls to gains.
    pub white_balance: WhiteBalanceTable,
    /// Signal of red, green and blue relative to the other cameras of the rig, by the temperature of the light.
    pub sensitivity: TemperatureTable,
}

impl Default for Tables {
    fn default() -> Self {
        Self {
            exposure: ExposureTable::Unit(EXPOSURE_UNIT_S),
            gain: None,
            white_balance: WhiteBalanceTable::Temperature(TemperatureTable::black_body()),
            sensitivity: TemperatureTable::constant([1.0; 3]),
        }
    }
}

impl Tables {
    /// Checks the tables of a configuration.
    ///
    /// # Errors
    /// When a table has too few or too many points, values out of range, or does not rise.
    pub fn new(config: &TablesConfig) -> Result<Self, TableError> {
        let mut tables = Self::default();
        if let Some(exposure) = &config.exposure_table {
            tables.exposure = exposure_table(exposure)?;
        }
        if let Some(gain) = &config.gain_table {
            tables.gain = Some(gain_curve("gain_table", &gain.points)?);
        }
        if let Some(white_balance) = &config.white_balance_table {
            tables.white_balance = white_balance_table(white_balance)?;
        }
        match (config.sensitivity, &config.sensitivity_table) {
            (None, None) => {}
            (Some(sensitivity), None) => {
                for channel in sensitivity {
                    check_value("sensitivity", channel, (0.01, 100.0), "0.01 to 100")?;
                }
                tables.sensitivity = TemperatureTable::constant(sensitivity);
            }
            (None, Some(by_light)) => {
                tables.sensitivity = TemperatureTable::new("sensitivity_table.temperatures", &by_light.temperatures)?;
            }
            (Some(_), Some(_)) => {
                return Err(TableError::Kinds {
                    table: "sensitivity",
                    found: "a table as well",
                    allowed: "`sensitivity` or `sensitivity_table`",
                });
            }
        }
        Ok(tables)
    }
}

fn check_value(
    table: &'static str,
    found: f64,
    (least, greatest): (f64, f64),
    allowed: &'static str,
) -> Result<(), TableError> {
    if found >= least && found <= greatest {
        Ok(())
    } else {
        Err(TableError::Value { table, found, allowed })
    }
}

fn exposure_table(config: &ExposureTableConfig) -> Result<ExposureTable, TableError> {
    if let Some(unit_s) = config.unit_s {
        check_value("exposure_table.unit_s", unit_s, (1e-9, 1.0), "1e-9 to 1 s")?;
    }
    match &config.points {
        None => Ok(ExposureTable::Unit(config.unit_s.unwrap_or(EXPOSURE_UNIT_S))),
        Some(points) => {
            let allowed = (1e-7, 100.0, "times from 1e-7 to 100 s");
            Ok(ExposureTable::Measured(Curve::new(
                "exposure_table.points",
                points,
                allowed,
            )?))
        }
    }
}

fn gain_curve(table: &'static str, points: &[(i64, f64)]) -> Result<Curve, TableError> {
    Curve::new(table, points, (0.001, 10_000.0, "linear gains from 0.001 to 10000"))
}

fn white_balance_table(config: &WhiteBalanceTableConfig) -> Result<WhiteBalanceTable, TableError> {
    let kinds = |found| TableError::Kinds {
        table: "white_balance_table",
        found,
        allowed: "`temperatures`, or both `red` and `blue`",
    };
    match (&config.temperatures, &config.red, &config.blue) {
        (Some(points), None, None) => {
            let table = "white_balance_table.temperatures";
            Ok(WhiteBalanceTable::Temperature(
                TemperatureTable::new(table, points)?.rising(table)?,
            ))
        }
        (None, Some(red), Some(blue)) => Ok(WhiteBalanceTable::RedBlue {
            red: gain_curve("white_balance_table.red", red)?,
            blue: gain_curve("white_balance_table.blue", blue)?,
        }),
        (None, None, None) => Err(kinds("neither")),
        (Some(_), _, _) => Err(kinds("both kinds")),
        (None, _, _) => Err(kinds("one of `red` and `blue`")),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn parse(text: &str) -> Result<Tables, String> {
        let config: TablesConfig = toml::from_str(text).map_err(|error| error.to_string())?;
        Tables::new(&config).map_err(|error| error.to_string())
    }

    #[test]
    fn tables_are_read() {
        let tables = parse(
            "sensitivity = [0.9, 1.0, 1.1]\n\
             exposure_table.points = [[1, 0.0001], [100, 0.0098], [333, 0.033]]\n\
             gain_table.points = [[0, 1.0], [64, 8.0]]\n\
             white_balance_table.temperatures = [[2800, [1.0, 1.0, 2.4]], [6500, [1.8, 1.0, 1.2]]]\n",
        )
        .unwrap();
        assert!((tables.exposure.time_s(100) - 0.0098).abs() < 1e-12);
        assert!((tables.exposure.value_for(0.0098) - 100.0).abs() < 1e-9);
        assert_eq!(tables.exposure.span(), (1, 333));
        assert!((tables.gain.as_ref().unwrap().at(32) - 4.5).abs() < 1e-12);
        let WhiteBalanceTable::Temperature(table) = tables.white_balance else {
            panic!("a temperature table")
        };
        assert!((table.gains(2800.0)[2] - 2.4).abs() < 1e-12 && table.gains(9000.0)[0] == 1.8);
        let gains = table.gains(4000.0);
        assert!((table.kelvin_for(gains[0] / gains[2]) - 4000.0).abs() < 0.01);
        assert_eq!(parse("").unwrap(), Tables::default());
        assert!(parse("white_balance_table = { red = [[0, 0.5], [9, 2.0]], blue = [[0, 0.5], [9, 2.0]] }").is_ok());
    }

    #[test]
    fn what_is_no_table_is_refused() {
        for (text, message) in [
            (
                "exposure_table.points = [[1, 0.1]]",
                "`exposure_table.points` has `1` points (allowed: 2 to 1024)",
            ),
            (
                "exposure_table.unit_s = 0.0",
                "`exposure_table.unit_s` has `0` (allowed: 1e-9 to 1 s)",
            ),
            (
                "gain_table.points = [[0, 1.0], [1, nan]]",
                "`gain_table` has `NaN` (allowed: linear gains from 0.001 to 10000)",
            ),
            (
                "gain_table.points = [[0, 1.0], [1, 1.0]]",
                "`gain_table` does not rise at control value `1` (allowed: values and what they stand for both rising)",
            ),
            (
                "white_balance_table.red = [[0, 1.0], [1, 2.0]]",
                "`white_balance_table` has one of `red` and `blue` (allowed: `temperatures`, or both `red` and `blue`)",
            ),
            (
                "white_balance_table.temperatures = [[2800, [2.0, 1, 1]], [6500, [1.0, 1, 2]]]",
                "`white_balance_table.temperatures` does not rise at control value `6500` (allowed: values and what \
                 they stand for both rising)",
            ),
            (
                "sensitivity = [1.0, 0.0, 1.0]",
                "`sensitivity` has `0` (allowed: 0.01 to 100)",
            ),
        ] {
            assert_eq!(parse(text).unwrap_err(), message);
        }
        assert!(
            parse("exposure_tabel.unit_s = 1.0")
                .unwrap_err()
                .contains("unknown field `exposure_tabel`")
        );
    }

    #[test]
    fn black_bodies_have_their_known_colours() {
        // D65 is near a black body of 6500 K but for a little green: white in BT.709 primaries.
        let rgb = black_body_rgb(6500.0);
        assert!(
            (rgb[0] / rgb[1] - 1.0).abs() < 0.08 && (rgb[2] / rgb[1] - 1.0).abs() < 0.08,
            "{rgb:?}"
        );
        // Illuminant A, 2856 K: x 0.4476, y 0.4074 (CIE 15), so linear (1.845, 0.826, 0.233) at Y = 1.
        let rgb = black_body_rgb(2856.0);
        assert!(
            rgb.iter()
                .zip([1.845, 0.826, 0.233])
                .all(|(found, known)| (found - known).abs() < 0.01),
            "{rgb:?}"
        );
    }

    proptest! {
        #[test]
        fn curves_invert(steps in prop::collection::vec((1_i64..50, 0.01_f64..3.0), 2..20), share in 0.0..1.0_f64) {
            let mut at = (0_i64, 1.0_f64);
            let points: Vec<(i64, f64)> = steps.iter().map(|step| {
                at = (at.0 + step.0, at.1 + step.1);
                at
            }).collect();
            let curve = gain_curve("test", &points).unwrap();
            let (first, last) = curve.span();
            let value = first + ((last - first) as f64 * share) as i64;
            prop_assert!((curve.value_for(curve.at(value)) - value as f64).abs() < 1e-6);
        }
    }
}

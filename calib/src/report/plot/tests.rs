//! Whatever the data, a plot is a drawing.

use proptest::prelude::*;

use super::*;

/// The drawing alone, without the HTML beside it.
fn parsed(plot: &Plot, check: impl Fn(&roxmltree::Document<'_>)) {
    let markup = format!("<div>{}</div>", plot.draw("a <name> & \"more\"").into_string());
    let document = roxmltree::Document::parse(&markup).unwrap_or_else(|error| panic!("{error}: {markup}"));
    assert!(
        document
            .descendants()
            .any(|node| node.has_tag_name(("http://www.w3.org/2000/svg", "svg")))
    );
    for node in document.descendants().filter(roxmltree::Node::is_element) {
        for attribute in node.attributes() {
            let value = attribute.value();
            assert!(!value.contains("NaN") && !value.contains("inf"), "{markup}");
        }
    }
    check(&document);
}

/// Data of `path`s in the colours of series, legend left out.
fn paths(document: &roxmltree::Document<'_>) -> Vec<String> {
    let drawing = document.descendants().find(|node| node.has_attribute("aria-label"));
    let paths = drawing.into_iter().flat_map(|node| {
        node.descendants()
            .filter(|node| node.has_tag_name(("http://www.w3.org/2000/svg", "path")))
    });
    paths
        .filter_map(|path| path.attribute("d").map(str::to_owned))
        .collect()
}

fn scale() -> impl Strategy<Value = Scale> {
    prop_oneof![Just(Scale::Linear), Just(Scale::Logarithmic)]
}

fn axis() -> impl Strategy<Value = Axis> {
    (any::<String>(), scale()).prop_map(|(name, scale)| Axis { name, scale })
}

fn series() -> impl Strategy<Value = Series> {
    let style = prop_oneof![Just(Style::Line), Just(Style::Dashed), Just(Style::Dots)];
    let points = prop::collection::vec(any::<[f64; 2]>(), 0..30);
    (any::<String>(), points, style).prop_map(|(name, points, style)| Series { name, points, style })
}

fn plot() -> impl Strategy<Value = Plot> {
    let number = prop::num::f64::ANY;
    prop_oneof![
        (axis(), axis(), prop::collection::vec(series(), 0..8)).prop_map(|(x, y, series)| Plot::Chart { x, y, series }),
        (
            any::<[u32; 2]>(),
            prop::collection::vec((any::<[f64; 2]>(), any::<[f64; 2]>()), 0..30),
            number
        )
            .prop_map(|(size_px, vectors, scale)| Plot::Vectors {
                size_px,
                vectors,
                scale
            }),
        (
            any::<[u32; 2]>(),
            0usize..9,
            prop::collection::vec(number, 0..60),
            axis()
        )
            .prop_map(|(size_px, columns, values, value)| Plot::HeatMap {
                size_px,
                columns,
                values,
                value
            }),
        (
            prop::collection::vec(any::<String>(), 0..4),
            prop::collection::vec((any::<String>(), prop::collection::vec(any::<[f64; 3]>(), 0..4)), 0..4)
        )
            .prop_map(|(columns, rows)| Plot::Patches { columns, rows }),
    ]
}

proptest! {
    #[test]
    fn any_data_give_a_drawing(plot in plot()) {
        parsed(&plot, |_| {});
    }
}

fn chart(points: Vec<[f64; 2]>, style: Style) -> Plot {
    Plot::Chart {
        x: Axis::linear("x"),
        y: Axis::linear("y"),
        series: vec![Series {
            name: "s".to_owned(),
            points,
            style,
        }],
    }
}

#[test]
fn points_are_where_they_belong() {
    parsed(
        &chart(vec![[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]], Style::Line),
        |document| {
            let paths = paths(document);
            assert_eq!(paths.len(), 1);
            let numbers: Vec<f64> = paths[0]
                .split(['M', 'L', ' '])
                .filter_map(|text| text.parse().ok())
                .collect();
            let [x0, y0, x1, y1, x2, y2] = numbers[..] else {
                panic!("{paths:?}")
            };
            // Right is more, up is more, and the middle is in the middle.
            assert!(x0 < x1 && x1 < x2 && y1 < y0 && y0 == y2, "{paths:?}");
            assert!((x1 - 0.5 * (x0 + x2)).abs() < 0.02, "{paths:?}");
        },
    );
}

#[test]
fn what_is_not_finite_is_a_gap() {
    let points = vec![
        [0.0, 0.0],
        [1.0, 1.0],
        [2.0, f64::NAN],
        [3.0, 1.0],
        [4.0, 0.0],
        [5.0, f64::INFINITY],
        [6.0, 1.0],
    ];
    parsed(&chart(points, Style::Line), |document| {
        let paths = paths(document);
        assert_eq!(paths[0].matches('M').count(), 3, "{paths:?}");
        assert_eq!(paths[0].matches('L').count(), 2, "{paths:?}");
        assert_eq!(paths[0].matches("h0").count(), 1, "a lonely point is a dot: {paths:?}");
    });
}

#[test]
fn a_million_points_are_a_page_of_moderate_size() {
    let many = |style| {
        let points = (0..1_000_000u32).map(|i| {
            // Scattered without order.
            let x = f64::from(i.wrapping_mul(2_654_435_761) >> 8);
            [x, f64::from(i.wrapping_mul(0x9E37_79B1) >> 4)]
        });
        chart(points.collect(), style)
    };
    for style in [Style::Line, Style::Dashed, Style::Dots] {
        assert!(many(style).draw("").into_string().len() < 400_000, "{style:?}");
    }
    let vectors = (0..300_000u32)
        .map(|i| ([f64::from(i % 640), f64::from(i / 640)], [0.1, f64::from(i % 7)]))
        .collect();
    let vectors = Plot::Vectors {
        size_px: [640, 480],
        vectors,
        scale: 10.0,
    };
    let text = vectors.draw("").into_string();
    assert!(text.len() < 400_000 && text.contains("the longest of every neighbourhood"));
    let map = Plot::HeatMap {
        size_px: [1920, 1080],
        columns: 1920,
        values: vec![0.25; 1920 * 1080],
        value: Axis::linear("σ, px"),
    };
    assert!(map.draw("").into_string().len() < 700_000);
}

#[test]
fn cells_have_their_values_as_titles_and_those_without_are_left_out() {
    let map = Plot::HeatMap {
        size_px: [640, 480],
        columns: 2,
        values: vec![0.5, f64::NAN, 2.0],
        value: Axis::linear("σ, px"),
    };
    parsed(&map, |document| {
        let titles: Vec<_> = document
            .descendants()
            .filter(|node| node.tag_name().name() == "title")
            .collect();
        let values: Vec<_> = titles.iter().filter_map(roxmltree::Node::text).collect();
        assert_eq!(values, ["0.5", "2"]);
        let fills: Vec<_> = titles
            .iter()
            .filter_map(|title| title.parent()?.attribute("fill"))
            .collect();
        assert_ne!(fills[0], fills[1]);
        assert_eq!(fills[1], "#fde725", "the largest value is the brightest");
    });
}

#[test]
fn vectors_are_enlarged_and_the_arrow_says_by_how_much() {
    let vectors = Plot::Vectors {
        size_px: [640, 480],
        vectors: vec![([100.0, 200.0], [1.0, 0.0])],
        scale: 50.0,
    };
    parsed(&vectors, |document| {
        let paths = paths(document);
        let numbers = |path: &str| -> Vec<f64> {
            path.split(['M', 'L', ' '])
                .filter_map(|text| text.parse().ok())
                .collect()
        };
        let is_line = |path: &&String| path.contains('L');
        let lines: Vec<Vec<f64>> = paths.iter().filter(is_line).map(|path| numbers(path)).collect();
        let length = |line: &[f64]| line[2] - line[0];
        assert!((length(&lines[0]) - length(&lines[1])).abs() < 0.03, "{lines:?}");
        assert!(document.descendants().any(|node| node.text() == Some("1 px")));
    });
}

#[test]
fn patches_have_their_colours() {
    let patches = Plot::Patches {
        columns: vec!["measured".to_owned(), "wanted".to_owned()],
        rows: vec![("grey".to_owned(), vec![[0.5, 0.5, 0.5], [f64::NAN, 0.0, 0.0]])],
    };
    parsed(&patches, |document| {
        let rects = document.descendants().filter(|node| node.tag_name().name() == "rect");
        let fills: Vec<_> = rects.filter_map(|node| node.attribute("fill")).collect();
        assert_eq!(fills, ["#808080", "none"]);
    });
}

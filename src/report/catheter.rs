//! Pages of the catheter's model: a shape, the reach, currents for a path.

use super::chart::{self, CURVE, PALETTE, css, rounded};
use super::html::escape;
use super::page::{self, card, facts_table, figure, table};
use crate::catheter::{Catheter, Followed, Reach, Sensitivity, Shape, Target};
use crate::plural::plural;
use nalgebra::Point3;
use plotly::common::{HoverInfo, Line, Marker, Mode};
use plotly::layout::{HoverMode, Margin};
use plotly::{Plot, Scatter, Scatter3D};

/// Axes of the base frame at the clamp.
const AXES: [&str; 3] = ["x, along B0 (mm)", "y (mm)", "z, clamp to tip (mm)"];

/// Where the tip moves less across than this part of its motion along, it reaches a surface.
const SURFACE: f64 = 1e-6;

/// The page of one shape.
pub(crate) fn shape_page(
    name: &str,
    catheter: &Catheter,
    currents_a: [f64; 3],
    shape: &Shape,
    by: &Sensitivity,
) -> String {
    let ma = page::minus(currents_a.map(|i| format!("{:.1}", i * 1e3)).join(", "));
    let cards = [
        card("θ", page::minus(format!("{:.2}°", shape.theta_rad().to_degrees())), "of the coil set's tangent", false),
        card("Polar angle", format!("{:.2}°", shape.polar_rad().to_degrees()), "from the straight tube", false),
        card("Tip", point(&shape.tip), "mm", false),
    ];
    let mut plot = space(&[shape.tip, Point3::origin(), shape.coil]);
    centre_line(&mut plot, shape, "centre line");
    let body = format!(
        "{}<dl class=\"key\">\n{}</dl>\n<h2>Shape</h2>\n<p>At rest under coil currents, weight and buoyancy. The \
         origin is the clamp.</p>\n{}<h2>What one more milliampere does</h2>\n{}<h2>Catheter</h2>\n{}",
        header("shape", &format!("{name} at {ma} mA")),
        cards.concat(),
        figure("plot-shape", &plot, 560, false),
        sensitivity(by),
        facts(catheter),
    );
    whole("Shape", name, body)
}

/// The page of the reach.
pub(crate) fn reach_page(name: &str, catheter: &Catheter, reach: &Reach) -> String {
    let (low, high) = reach.theta_rad();
    let [least, most] = reach.tip_box();
    let across = page::minus(format!("motion across it by motion along it: {:.0e}", reach.thickness));
    let cards = [
        card(
            "θ",
            page::minus(format!("{:.1}° to {:.1}°", low.to_degrees(), high.to_degrees())),
            "within the limit",
            false,
        ),
        card(
            "Tip, across",
            format!("{:.1} × {:.1} mm", (most.x - least.x) * 1e3, (most.y - least.y) * 1e3),
            "x × y",
            false,
        ),
        card("Tip reaches", if reach.thickness < SURFACE { "a surface" } else { "a volume" }, across, false),
    ];
    let mut plot = space(&[least, most, Point3::origin()]);
    let [x, y, z] = coordinates(reach.reached.iter().map(|r| r.tip));
    plot.add_trace(
        Scatter3D::new(x, y, z)
            .name("tip")
            .mode(Mode::Markers)
            .marker(Marker::new().size(2).color(css(CURVE)))
            .hover_template("(%{x:.2f}, %{y:.2f}, %{z:.2f}) mm"),
    );
    let without = match reach.without_shape {
        0 => String::new(),
        n => format!(
            "<p>{n} of {} settings of the currents have no stable shape: a moment that points against B0 turns over, \
             like a compass needle held the wrong way round.</p>\n",
            n + reach.reached.len()
        ),
    };
    let body = format!(
        "{}<dl class=\"key\">\n{}</dl>\n<h2>Where the tip gets to</h2>\n<p>A moment along B0 has no couple, so that \
         one coil set reaches a surface, not a volume. Each dot is the tip at one setting of the currents within the \
         limit.</p>\n{without}{}<h2>Catheter</h2>\n{}",
        header("reach", name),
        cards.concat(),
        figure("plot-reach", &plot, 620, false),
        facts(catheter),
    );
    whole("Reach", name, body)
}

/// The page of a path to follow; points are one period.
pub(crate) fn follow_page(
    name: &str,
    catheter: &Catheter,
    path: &str,
    targets: &[Target],
    followed: &[Followed],
) -> String {
    let worst_m = followed.iter().map(|f| f.off_m).fold(0.0, f64::max);
    let at_limit = followed.iter().filter(|f| f.at_limit).count();
    let peak_a = followed.iter().map(|f| f.currents_a.amax()).fold(0.0, f64::max);
    let cards = [
        card("Largest distance", format!("{:.3} mm", worst_m * 1e3), "from the path to the tip", worst_m > 1e-4),
        card("Points", followed.len().to_string(), "each period", false),
        card(
            "Largest current",
            format!("{:.1} mA", peak_a * 1e3),
            format!("{} at the limit", plural(at_limit, "point")),
            at_limit > 0,
        ),
    ];
    let tips: Vec<Point3<f64>> = followed.iter().map(|f| f.shape.tip).collect();
    let mut plot = space(&[tips.as_slice(), &[Point3::origin()]].concat());
    let closed =
        |points: Vec<Point3<f64>>| coordinates(points.iter().chain(points.first()).copied().collect::<Vec<_>>());
    let [x, y, z] = closed(tips);
    plot.add_trace(
        Scatter3D::new(x, y, z).name("tip").mode(Mode::Lines).line(Line::new().width(4.0).color(css(CURVE))),
    );
    let wanted = targets.iter().zip(followed).map(|(target, f)| match target {
        Target::Across([x, y]) => Point3::new(*x, *y, f.shape.tip.z),
        Target::Space(point) => *point,
    });
    let [x, y, z] = closed(wanted.collect());
    plot.add_trace(
        Scatter3D::new(x, y, z)
            .name("path as asked for")
            .mode(Mode::Lines)
            .line(Line::new().width(2.0).color("#b6bbc2")),
    );
    if let Some(first) = followed.first() {
        centre_line(&mut plot, &first.shape, "catheter at the first point");
    }
    let layout = chart::layout()
        .x_axis(chart::value_axis("Point"))
        .y_axis(chart::value_axis("Current (mA)"))
        .hover_mode(HoverMode::XUnified);
    let mut currents = chart::plot(layout);
    for (coil, name) in ["x", "y", "z"].into_iter().enumerate() {
        let number: Vec<usize> = (1..=followed.len()).collect();
        let values: Vec<Option<f64>> = followed.iter().map(|f| rounded(f.currents_a[coil] * 1e3, 4)).collect();
        let line = Line::new().width(1.4).color(css(PALETTE.marker(coil)));
        currents.add_trace(Scatter::new(number, values).name(format!("coil {name}")).mode(Mode::Lines).line(line));
    }
    let body = format!(
        "{}<dl class=\"key\">\n{}</dl>\n<h2>Path of the tip</h2>\n{}<h2>Currents of one period</h2>\n<p>The smallest \
         currents that do it: one direction of currents moves nothing and is left at \
         rest.</p>\n{}<h2>Catheter</h2>\n{}",
        header("path", &format!("{path}, {name}")),
        cards.concat(),
        figure("plot-path", &plot, 560, false),
        figure("plot-currents", &currents, 340, false),
        facts(catheter),
    );
    whole("Path", name, body)
}

fn header(kind: &str, title: &str) -> String {
    // The name of a catheter that has no file begins with a small letter.
    let title = title.strip_prefix("the ").map_or(title.to_owned(), |rest| format!("The {rest}"));
    format!("<header>\n<p class=\"kind\">Catoptra catheter: {kind}</p>\n<h1>{}</h1>\n</header>\n", escape(&title))
}

fn whole(kind: &str, name: &str, body: String) -> String {
    let footer = page::footer("");
    page::page(&format!("{kind}: {name}"), &(body + &footer))
}

/// A 3D plot with room for these points, with the catheter hanging down.
fn space(points: &[Point3<f64>]) -> Plot {
    let span = |k: usize| {
        let values = points.iter().map(|p| p.coords[k] * 1e3);
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
    };
    let scene = chart::scene([0, 1, 2].map(span), AXES).camera(chart::eye((0.0, 0.0, -1.0), (0.5, 1.5, -0.5)));
    let layout = chart::layout()
        .scene(scene)
        .hover_mode(HoverMode::Closest)
        .margin(Margin::new().left(0).right(0).top(28).bottom(0));
    chart::plot(layout)
}

fn coordinates(points: impl IntoIterator<Item = Point3<f64>>) -> [Vec<Option<f64>>; 3] {
    let mut all = [Vec::new(), Vec::new(), Vec::new()];
    for point in points {
        for (list, value) in all.iter_mut().zip(point.iter()) {
            list.push(rounded(value * 1e3, 4));
        }
    }
    all
}

fn centre_line(plot: &mut Plot, shape: &Shape, name: &str) {
    let [x, y, z] = coordinates(shape.centre_line.iter().map(|(_, point)| *point));
    plot.add_trace(
        Scatter3D::new(x, y, z)
            .name(name)
            .mode(Mode::Lines)
            .line(Line::new().width(6.0).color("#8a9099"))
            .hover_template("(%{x:.2f}, %{y:.2f}, %{z:.2f}) mm"),
    );
    let [x, y, z] = coordinates([shape.coil]);
    plot.add_trace(
        Scatter3D::new(x, y, z)
            .name("coil set")
            .mode(Mode::Markers)
            .marker(Marker::new().size(5).color(css(PALETTE.marker(1))))
            .hover_info(HoverInfo::Skip),
    );
}

fn point(point: &Point3<f64>) -> String {
    page::minus(format!("{:.2}, {:.2}, {:.2}", point.x * 1e3, point.y * 1e3, point.z * 1e3))
}

fn sensitivity(by: &Sensitivity) -> String {
    let rows: Vec<Vec<String>> = ["x", "y", "z"]
        .into_iter()
        .enumerate()
        .map(|(coil, name)| {
            let tip = by.tip_m_a.column(coil);
            let tangent = by.tangent_a.column(coil);
            let all = tip.iter().map(|v| format!("{v:.4}")).chain(tangent.iter().map(|v| format!("{:.5}", v * 1e-3)));
            std::iter::once(format!("coil {name}")).chain(all.map(page::minus)).collect()
        })
        .collect();
    table(1, &["1 mA in", "tip x (mm)", "tip y (mm)", "tip z (mm)", "tangent x", "tangent y", "tangent z"], &rows)
}

fn facts(catheter: &Catheter) -> String {
    let Catheter { tube, coils, surroundings, .. } = catheter;
    let vector = |v: &nalgebra::Vector3<f64>| page::minus(format!("({}, {}, {})", v.x, v.y, v.z));
    facts_table(&[
        (
            "Lengths",
            format!(
                "{:.2} mm flexible, {:.2} mm coil set, {:.2} mm tail",
                catheter.flexible_m * 1e3,
                catheter.coil_m * 1e3,
                catheter.tail_m * 1e3
            ),
        ),
        ("Bending stiffness EI", format!("{:.3e} N·m²", tube.bending_nm2())),
        ("Torsional stiffness GJ", format!("{:.3e} N·m²", tube.torsion_nm2())),
        ("Limit of the currents", format!("{:.1} mA", coils.limit_a * 1e3)),
        ("B0", format!("{} T", vector(&surroundings.b0_t))),
        ("Gravity", format!("{} m/s²", vector(&surroundings.gravity_m_s2))),
        ("Fluid", format!("{} kg/m³", surroundings.fluid_kg_m3)),
    ])
}

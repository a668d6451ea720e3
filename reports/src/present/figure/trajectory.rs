//! One period of target and actual position: the path in the plane, and both coordinates over time. The period is the
//! last one of the first window that counts, where the transient is over.

use plotters::{prelude::RGBColor, series::LineSeries, style::ShapeStyle};
use record::{report_settings::ErrorOf, run_directory::PeriodPath};

use super::{
    Figure, FigureError, Kind, Layout,
    canvas::{About, Area, Axes, DrawingError, Sample, colour, drawn, legend, line, pt},
};
use crate::{analysis::report::Report, input::run::ScenarioRun, present::colours};

/// More points than this are not seen, and make the file large.
const POINTS: usize = 1000;
/// Of the target, which is no scenario's own.
const TARGET: RGBColor = RGBColor(150, 150, 150);
/// For the path in the plane: so that it has one scale both ways.
const PLANE_PT: f64 = 155.0;

pub(super) fn draw(
    report: &Report,
    scenario: &ScenarioRun,
    error: ErrorOf,
    layout: Layout,
) -> Result<Option<Figure>, FigureError> {
    let mut counted = scenario.counted();
    let Some((window, trace)) = counted.find_map(|(window, _, data)| Some((window, data.trace()?))) else {
        return Ok(None);
    };
    let planned = &scenario.planned;
    let about = About {
        kind: Kind::Trajectory,
        of: planned.id.clone(),
        caption: format!(
            "One period of target and actual position of {} {}: the last of window {window}. The actual position is {}.",
            planned.id,
            planned.slug,
            match error {
                ErrorOf::Received => "as the controller received it",
                ErrorOf::TruePosition => "where the ball was",
            }
        ),
        is_simulated: scenario.is_simulated(),
        height_pt: 165.0,
    };
    let period_s = planned.settings.period.as_secs_f64();
    let actual = colour(colours::of(report, &planned.id));
    drawn(about, layout, |area| {
        draw_period(area, &trace.last_period, actual, period_s)
    })
    .map(Some)
}

fn draw_period(
    area: &Area<'_>,
    path: &PeriodPath,
    actual: RGBColor,
    period_s: f64,
) -> Result<(), DrawingError> {
    let curves = curves(path, actual);
    let below = legend(
        area,
        &curves.each_ref().map(|it| (Sample::Line(it.style), it.name)),
    )?;
    let (plane, over_time) = below.split_horizontally(pt(PLANE_PT));
    let reach = reach(path);
    draw_plane(&plane, &curves, reach)?;
    let names = [("", "x (m)"), ("time (s)", "y (m)")];
    let coordinates: [Coordinate; 2] = [|point| point.0, |point| point.1];
    for ((area, names), of) in over_time.split_evenly((2, 1)).iter().zip(names).zip(coordinates) {
        draw_coordinate(area, &curves, reach, period_s, names, of)?;
    }
    Ok(())
}

/// Of a point (x, y), in metres, one of the two.
type Coordinate = fn(&(f64, f64)) -> f64;

/// The largest coordinate and some room, so that both axes have one scale.
fn reach(path: &PeriodPath) -> f64 {
    let points = path.reference_m.iter().chain(&path.position_m);
    let farthest = points.map(|(x, y)| x.abs().max(y.abs())).fold(0.0, f64::max);
    if farthest > 0.0 { 1.1 * farthest } else { 1.0 }
}

/// One of the two curves.
struct Curve<'a> {
    name: &'static str,
    style: ShapeStyle,
    points: &'a [(f64, f64)],
}

/// The target below the actual path, and wider, so that both are seen where they meet.
fn curves(path: &PeriodPath, actual: RGBColor) -> [Curve<'_>; 2] {
    let style = |colour: RGBColor, width_pt| line(colour, width_pt);
    [
        Curve {
            name: "target",
            style: style(TARGET, 1.5),
            points: &path.reference_m,
        },
        Curve {
            name: "actual",
            style: style(actual, 0.6),
            points: &path.position_m,
        },
    ]
}

fn thinned<T: Copy>(points: &[T]) -> impl Iterator<Item = (usize, T)> {
    let every = points.len().div_ceil(POINTS).max(1);
    points.iter().copied().enumerate().step_by(every)
}

fn draw_plane(area: &Area<'_>, curves: &[Curve<'_>; 2], reach: f64) -> Result<(), DrawingError> {
    let axes = Axes {
        x: -reach..reach,
        y: -reach..reach,
        names: ["x (m)", "y (m)"],
        ticks: [5, 5],
        sides_pt: [34.0, 8.0],
    };
    let mut chart = axes.draw(area)?;
    for Curve { style, points, .. } in curves {
        chart.draw_series(LineSeries::new(thinned(points).map(|(_, point)| point), *style))?;
    }
    Ok(())
}

fn draw_coordinate(
    area: &Area<'_>,
    curves: &[Curve<'_>; 2],
    reach: f64,
    period_s: f64,
    (x, y): (&str, &str),
    of: impl Fn(&(f64, f64)) -> f64,
) -> Result<(), DrawingError> {
    let axes = Axes {
        x: 0.0..period_s,
        y: -reach..reach,
        names: [x, y],
        ticks: [4, 3],
        sides_pt: [34.0, 8.0],
    };
    let mut chart = axes.draw(area)?;
    for Curve { style, points, .. } in curves {
        let step_s = period_s / points.len().max(1) as f64;
        let points = thinned(points).map(|(index, point)| (index as f64 * step_s, of(&point)));
        chart.draw_series(LineSeries::new(points, *style))?;
    }
    Ok(())
}

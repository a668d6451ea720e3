//! One period of target and actual position: the path in the plane, and both coordinates over time. The period is the
//! last one of the first window that counts, where the transient is over.

use plotters::{
    chart::{ChartBuilder, SeriesLabelPosition},
    prelude::{BLACK, Color, LineSeries, PathElement, WHITE},
    style::{RGBColor, ShapeStyle},
};

use super::{Area, DrawingError, FIRST, FRAME, Figure, FigureError, GRID, SECOND, drawn, label};
use crate::{run::ScenarioRun, run_directory::PeriodPath};

/// More points than this are not seen, and make the file large.
const POINTS: usize = 1000;

pub(super) fn draw(scenario: &ScenarioRun) -> Result<Option<Figure>, FigureError> {
    let Some((window, _, trace)) = scenario.counted().next() else {
        return Ok(None);
    };
    let planned = &scenario.planned;
    let caption = [
        format!("{} {}: target and actual position", planned.id, planned.slug),
        format!("Last period of window {window}; the actual position is as the controller received it"),
    ];
    let name = format!("trajectory-{}.svg", planned.id);
    let period_s = planned.settings.period.as_secs_f64();
    drawn(name, (1000, 560), &caption, scenario.is_simulated(), |area| {
        draw_period(area, &trace.last_period, period_s)
    })
    .map(Some)
}

fn draw_period(area: &Area<'_>, path: &PeriodPath, period_s: f64) -> Result<(), DrawingError> {
    let (plane, over_time) = area.split_horizontally(490);
    let reach = reach(path);
    draw_plane(&plane, path, reach)?;
    for (panel, name, of) in [
        (0, "x (m)", (|p: &(f64, f64)| p.0) as fn(&(f64, f64)) -> f64),
        (1, "y (m)", |p| p.1),
    ] {
        let panels = over_time.split_evenly((2, 1));
        if let Some(area) = panels.get(panel) {
            draw_coordinate(area, path, reach, period_s, name, of)?;
        }
    }
    Ok(())
}

/// The largest coordinate and some room, so that both axes have one scale.
fn reach(path: &PeriodPath) -> f64 {
    let points = path.reference_m.iter().chain(&path.received_m);
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
fn curves(path: &PeriodPath) -> [Curve<'_>; 2] {
    let style = |colour: RGBColor, width| ShapeStyle::from(colour).stroke_width(width);
    [
        Curve {
            name: "target",
            style: style(SECOND, 2),
            points: &path.reference_m,
        },
        Curve {
            name: "actual",
            style: style(FIRST, 1),
            points: &path.received_m,
        },
    ]
}

fn thinned<T: Copy>(points: &[T]) -> impl Iterator<Item = (usize, T)> {
    let every = points.len().div_ceil(POINTS).max(1);
    points.iter().copied().enumerate().step_by(every)
}

fn draw_plane(area: &Area<'_>, path: &PeriodPath, reach: f64) -> Result<(), DrawingError> {
    let mut chart = ChartBuilder::on(area)
        .margin(14)
        .x_label_area_size(40)
        .y_label_area_size(48)
        .build_cartesian_2d(-reach..reach, -reach..reach)?;
    chart
        .configure_mesh()
        .light_line_style(BLACK.mix(0.0))
        .bold_line_style(GRID)
        .x_desc("x (m)")
        .y_desc("y (m)")
        .label_style(label())
        .axis_desc_style(label())
        .draw()?;
    for Curve { name, style, points } in curves(path) {
        chart
            .draw_series(LineSeries::new(thinned(points).map(|(_, point)| point), style))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 22, y)], style));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE)
        .border_style(FRAME)
        .label_font(label())
        .draw()
}

fn draw_coordinate(
    area: &Area<'_>,
    path: &PeriodPath,
    reach: f64,
    period_s: f64,
    name: &str,
    of: impl Fn(&(f64, f64)) -> f64,
) -> Result<(), DrawingError> {
    let step_s = period_s / path.reference_m.len().max(1) as f64;
    let mut chart = ChartBuilder::on(area)
        .margin(14)
        .x_label_area_size(40)
        .y_label_area_size(48)
        .build_cartesian_2d(0.0..period_s, -reach..reach)?;
    chart
        .configure_mesh()
        .light_line_style(BLACK.mix(0.0))
        .bold_line_style(GRID)
        .x_desc("time within the period (s)")
        .y_desc(name)
        .y_labels(5)
        .label_style(label())
        .axis_desc_style(label())
        .draw()?;
    for Curve { style, points, .. } in curves(path) {
        let points = thinned(points).map(|(index, point)| (index as f64 * step_s, of(&point)));
        chart.draw_series(LineSeries::new(points, style))?;
    }
    Ok(())
}

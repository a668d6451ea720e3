//! The control loop with what delays its signals: the network from the controller to the plant and back.

use plotters::style::text_anchor::HPos;
use record::settings::Settings;

use super::{
    Figure, FigureError, Kind, Layout,
    canvas::{About, Area, COLUMN_PT, DrawingError, column_of, drawn},
    schematic::{MOST_DRAWN, Schematic, alike, letters_of, not_drawn, of_the_ball},
    topology::delay,
};
use crate::input::run::Run;

/// Draws each control loop of the run once.
pub(super) fn draw(run: &Run, layout: Layout) -> Result<Vec<Figure>, FigureError> {
    let groups = alike(of_the_ball(run), |scenario| {
        let settings = &scenario.planned.settings;
        (values(settings), delay(&settings.network))
    });
    let shown = groups.iter().take(MOST_DRAWN).enumerate();
    let figures = shown.filter_map(|(at, ((values, delay), group))| {
        let first = group.first()?;
        let about = About {
            kind: Kind::ControlLoop,
            of: first.planned.id.clone(),
            caption: format!(
                "The control loop: R(s) is the target, E(s) the error, U(s) the input of the plant and Y(s) its output. The network \
                 delays U(s) on its way from controller to actuator (ca), and Y(s) on its way from sensor to controller (sc). {}: \
                 {values}.{}",
                letters_of(group),
                not_drawn(at, groups.len())
            ),
            is_simulated: group.iter().any(|scenario| scenario.is_simulated()),
            height_pt: 122.0,
        };
        Some(drawn(about, layout, |area| draw_loop(&column_of(area), delay)))
    });
    figures.collect()
}

/// What controller and plant are set to.
fn values(settings: &Settings) -> String {
    let (control, plant) = (&settings.control, &settings.plant);
    format!(
        "dynamics {}; both at {}; gains kp = {}, kd = {} of the ball's position and kp = {}, kd = {} of the shaft's angle; motor b0 = {}, b1 = {}",
        settings.dynamics.name(),
        settings.rate,
        control.position.kp,
        control.position.kd,
        control.angle.kp,
        control.angle.kd,
        plant.b0,
        plant.b1
    )
}

fn draw_loop(area: &Area<'_>, delay: &str) -> Result<(), DrawingError> {
    const FORWARD: f64 = 30.0;
    const BACK: f64 = 84.0;
    const SUM: f64 = 44.0;
    const RADIUS: f64 = 5.0;
    const OUT: f64 = 243.0;
    let drawing = Schematic(area);
    drawing.words((18.0, FORWARD - 9.0), HPos::Center, "R(s)")?;
    drawing.arrow(&[(4.0, FORWARD), (SUM - RADIUS, FORWARD)])?;
    drawing.words((SUM - 11.0, FORWARD + 6.0), HPos::Center, "+")?;
    drawing.words((SUM + 7.0, FORWARD + 12.0), HPos::Center, "−")?;
    drawing.words((62.0, FORWARD - 9.0), HPos::Center, "E(s)")?;
    drawing.arrow(&[(SUM + RADIUS, FORWARD), (76.0, FORWARD)])?;
    drawing.labelled((100.0, FORWARD), (48.0, 30.0), &["controller", "sta1"])?;
    drawing.words((137.0, FORWARD - 9.0), HPos::Center, "U(s)")?;
    drawing.arrow(&[(124.0, FORWARD), (150.0, FORWARD)])?;
    drawing.labelled((164.0, FORWARD), (28.0, 20.0), &[])?;
    drawing.raised((164.0, FORWARD), "τ", "ca")?;
    drawing.arrow(&[(178.0, FORWARD), (192.0, FORWARD)])?;
    drawing.labelled((210.0, FORWARD), (36.0, 30.0), &["plant", "sta2"])?;
    drawing.words((240.0, FORWARD - 9.0), HPos::Center, "Y(s)")?;
    drawing.arrow(&[(OUT - 15.0, FORWARD), (250.0, FORWARD)])?;

    drawing.arrow(&[(OUT, FORWARD), (OUT, BACK), (146.0, BACK)])?;
    drawing.labelled((132.0, BACK), (28.0, 20.0), &[])?;
    drawing.raised((132.0, BACK), "τ", "sc")?;
    drawing.arrow(&[(118.0, BACK), (SUM, BACK), (SUM, FORWARD + RADIUS)])?;
    drawing.sum((SUM, FORWARD), RADIUS)?;
    let words = format!("each τ: two ends of links, {delay} each, and what TCP adds");
    drawing.words((COLUMN_PT / 2.0, 110.0), HPos::Center, &words)
}

//! `catoptra catheter`: what the catheter does for given currents, and which currents make it follow a path.

mod bands;
mod fit;
mod folder;
mod follow;
mod recorded;
mod run;

pub(super) use run::Columns;

use super::output::{PAGE, is_free_for_page, save};
use super::units::current_a;
use super::{Exit, Failure, interrupt, output, writing};
use crate::catheter::{Catheter, CatheterError, Load, equilibrium, reach};
use crate::report::catheter as pages;
use clap::Subcommand;
use folder::{Own, prepare};
use nalgebra::Vector3;
use std::fmt::Write as _;
use std::path::PathBuf;

/// The header of `reach.csv`.
const REACHED: &str = "x_a,y_a,z_a,tip_x_mm,tip_y_mm,tip_z_mm,tan_x,tan_y,tan_z,theta_deg\r\n";

/// Arguments of `catoptra catheter`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// The shape at rest for given currents, and how tip and tangent follow them
    #[command(after_help = "\
Base frame with its origin at the clamp: z along the straight tube, x along B0. Exit code 3: no
stable shape can be reached from rest.
Example:
  catoptra catheter shape --currents 0mA,0mA,100mA -o shape.html")]
    Shape(ShapeArgs),
    /// Where the tip can get to within the limit of the currents
    #[command(after_help = "Example:\n  catoptra catheter reach -o reach")]
    Reach(ReachArgs),
    /// Currents that lead the tip along a path
    #[command(after_help = "\
DIR gets desired.csv (for validate), follow.html and for each pause currents_PAUSE.csv (for live
and identify) and .play (for the amplifier). A drawing in x and y is projected along z on what the
tip reaches; of a path with z the nearest points are followed. Says what is out of reach.
Example:
  catoptra catheter follow circle --centre 28mm,0mm --radius 8mm --pause 20ms,100ms -o circle")]
    Follow(follow::FollowArgs),
    /// What a camera would record under given currents: the catheter in motion, in its fluid
    #[command(after_help = "\
From rest without currents. RUN.csv has the columns of a tracked run; identify, validate and
catheter fit read it.
Example:
  catoptra catheter run circle/currents_20ms.csv --noise 0.04,0.15 --missing 5 -o run.csv")]
    Run(run::RunArgs),
    /// Stiffness, alignment, curvature at rest, damping and drag from tracked runs
    #[command(after_help = "\
Shapes at rest come first, then all frames in motion. DIR gets catheter.toml, fit.csv and fit.html.
What the runs do not determine stays as it was, and is named with the experiment that would
determine it. Exit code 3: something asked for with --parameters is not determined.
Example:
  catoptra catheter fit sample_dynamics/catheter_run.csv --settle 2s \\
    --currents sample_dynamics/catheter_currents.csv --parameters young,shear,damping,drag -o fit")]
    Fit(fit::FitArgs),
}

#[derive(Debug, clap::Args)]
struct Common {
    /// The catheter, see sample_dynamics/catheter.toml [default: the paper's prototype]
    #[arg(long, value_name = "CATHETER.toml")]
    catheter: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
struct ShapeArgs {
    #[command(flatten)]
    common: Common,
    /// Currents of the coils x, y, z
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', value_parser = current_a, allow_hyphen_values = true)]
    currents: Vec<f64>,
    /// Also write a page with a drawing
    #[arg(short, long, value_name = "FILE.html")]
    out: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
struct ReachArgs {
    #[command(flatten)]
    common: Common,
    /// Settings along each edge of the box of allowed currents, one more if even
    #[arg(long, value_name = "N", default_value_t = 9, value_parser = clap::value_parser!(u16).range(2..=41))]
    steps: u16,
    /// Folder for reach.csv and reach.html
    #[arg(short, long, value_name = "DIR")]
    out: Option<PathBuf>,
}

pub(crate) fn run(args: &Args, quiet: bool) -> Result<(), Failure> {
    interrupt::end_at_once()?;
    match &args.command {
        Command::Shape(args) => args.run(),
        Command::Reach(args) => args.run(),
        Command::Follow(args) => args.run(quiet),
        Command::Run(args) => args.run(quiet),
        Command::Fit(args) => args.run(quiet),
    }
}

/// Part of B0 along y from which x of the base frame is not along it.
const ALONG_X: f64 = 0.01;

impl Common {
    fn load(&self) -> Result<(String, Catheter), Failure> {
        match &self.catheter {
            None => Ok(("the paper's prototype".to_owned(), Catheter::prototype())),
            Some(file) => {
                let catheter = Catheter::load(file).map_err(failure)?;
                let b0 = catheter.surroundings.b0_t;
                if b0.y.abs() > ALONG_X * b0.norm() || b0.x < 0.0 {
                    let [x, y, z] = [b0.x, b0.y, b0.z];
                    tracing::warn!(
                        "{}: surroundings.b0_t = [{x}, {y}, {z}]: x of the base frame is expected along B0, so that y \
                         is 0; θ is not the angle in the plane of B0: turn the field, gravity and coils",
                        file.display()
                    );
                }
                Ok((file.display().to_string(), catheter))
            }
        }
    }
}

fn failure(error: CatheterError) -> Failure {
    let exit = match &error {
        CatheterError::Unstable { .. } | CatheterError::NotConverged { .. } => Exit::Unusable,
        _ => Exit::Usage,
    };
    Failure::new(exit, error)
}

impl ShapeArgs {
    fn run(&self) -> Result<(), Failure> {
        let &[x, y, z] = self.currents.as_slice() else {
            let text =
                format!("--currents: {} given, expected three: X,Y,Z such as 0mA,0mA,100mA", self.currents.len());
            return Err(Failure::usage(text));
        };
        if let Some(out) = &self.out {
            is_free_for_page(out)?;
        }
        let (name, catheter) = self.common.load()?;
        let shape = equilibrium(&catheter, &Load::currents(Vector3::new(x, y, z))).map_err(failure)?;
        let by = shape.sensitivity(&catheter).map_err(failure)?;
        let mut text = format!("{name} at {:.1}, {:.1}, {:.1} mA\n\n", x * 1e3, y * 1e3, z * 1e3);
        // Writing into text cannot fail.
        let _ = writeln!(text, "  θ        {:>9.3}°", shape.theta_rad().to_degrees());
        let _ = writeln!(text, "  polar    {:>9.3}°", shape.polar_rad().to_degrees());
        for (name, point) in [("coil", shape.coil.coords), ("tip", shape.tip.coords)] {
            let _ =
                writeln!(text, "  {name:<8} {:>9.3} {:>9.3} {:>9.3} mm", point.x * 1e3, point.y * 1e3, point.z * 1e3);
        }
        let _ = writeln!(text, "  tangent  {:>9.5} {:>9.5} {:>9.5}", shape.tangent.x, shape.tangent.y, shape.tangent.z);
        let clamp = shape.clamp_nm * 1e6;
        let _ = writeln!(text, "  clamp    {:>9.2} {:>9.2} {:>9.2} µN·m", clamp.x, clamp.y, clamp.z);
        let _ = writeln!(text, "\n  1 mA more in   tip (mm)                       tangent");
        for (k, coil) in ["x", "y", "z"].into_iter().enumerate() {
            let (tip, tangent) = (by.tip_m_a.column(k), by.tangent_a.column(k) * 1e-3);
            let _ = writeln!(
                text,
                "  coil {coil}       {:>9.4} {:>9.4} {:>9.4}   {:>9.6} {:>9.6} {:>9.6}",
                tip[0] + 0.0,
                tip[1] + 0.0,
                tip[2] + 0.0,
                tangent[0] + 0.0,
                tangent[1] + 0.0,
                tangent[2] + 0.0
            );
        }
        if let Some(out) = &self.out {
            save(out, &pages::shape_page(&name, &catheter, [x, y, z], &shape, &by))?;
            let _ = writeln!(text, "\nwritten: {}", out.display());
        }
        output::print(&text)
    }
}

impl ReachArgs {
    fn run(&self) -> Result<(), Failure> {
        let (name, catheter) = self.common.load()?;
        let files = [("reach.csv", Own::Begins(REACHED)), ("reach.html", Own::Begins(PAGE))];
        if let Some(out) = &self.out {
            prepare(out, &files, self.common.catheter.as_deref().as_slice())?;
        }
        let found = reach(&catheter, usize::from(self.steps)).map_err(failure)?;
        let (low, high) = found.theta_rad();
        let [least, most] = found.tip_box();
        let mut text = format!("{name}, currents up to {:.1} mA\n\n", catheter.coils.limit_a * 1e3);
        let _ = writeln!(text, "  θ        {:.1}° to {:.1}°", low.to_degrees(), high.to_degrees());
        for (axis, (low, high)) in ["x", "y", "z"].iter().zip(least.iter().zip(most.iter())) {
            let _ = writeln!(text, "  tip {axis}    {:.1} mm to {:.1} mm", low * 1e3, high * 1e3);
        }
        let _ = writeln!(
            text,
            "  a surface: a moment along B0 moves nothing (across by along it: {:.0e})",
            found.thickness
        );
        if found.without_shape > 0 {
            let _ = writeln!(
                text,
                "  {} of {} settings have no stable shape (moment against B0)",
                found.without_shape,
                found.without_shape + found.reached.len()
            );
        }
        if let Some(out) = &self.out {
            let mut csv = REACHED.to_owned();
            for r in &found.reached {
                let (i, p, t) = (r.currents_a, r.tip * 1e3, r.tangent);
                let _ = write!(csv, "{:.6},{:.6},{:.6},{:.6},{:.6},{:.6},", i.x, i.y, i.z, p.x, p.y, p.z);
                let _ = write!(csv, "{:.8},{:.8},{:.8},{:.6}\r\n", t.x, t.y, t.z, r.theta_rad.to_degrees());
            }
            let _whole = writing::wait();
            save(&out.join("reach.csv"), &csv)?;
            save(&out.join("reach.html"), &pages::reach_page(&name, &catheter, &found))?;
            let _ = writeln!(text, "\nwritten: {} in {}", files.map(|(name, _)| name).join(", "), out.display());
        }
        output::print(&text)
    }
}

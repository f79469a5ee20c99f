#![allow(clippy::all, clippy::pedantic, missing_docs, clippy::unwrap_used, clippy::print_stdout)]
use catoptra::{rig::Rig, sink::*, source::*, track::*};
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let rig = Rig::load(std::path::Path::new(&a[2])).unwrap();
    let mut src = catoptra::source::open(std::path::Path::new(&a[1]), SourceOptions::default()).unwrap();
    let mut t = Tracker::new(&rig, TrackOptions { full_frame: a.len() > 4 }).unwrap();
    let mut csv = CsvSink::create(std::path::Path::new(&a[3]), &rig, OutputFrame::Camera).unwrap();
    let mut busy = 0.0;
    let mut n = 0;
    let mut extra = String::from("i,m,v,rx,ry,sx,sy,rms,sep\n");
    while let Some(f) = src.next_frame().unwrap() {
        let t0 = std::time::Instant::now();
        let e = t.step(&f).unwrap();
        busy += t0.elapsed().as_secs_f64();
        n += 1;
        for (m, k) in e.markers.iter().enumerate() {
            if let Err(x) = &k.position {
                println!("{} {m} {x:?}", e.seq);
            }
            for (v, b) in k.views.iter().enumerate() {
                if let Ok(b) = b {
                    extra += &format!(
                        "{},{m},{v},{},{},{},{},{},{}\n",
                        e.seq,
                        b.residual_px.x,
                        b.residual_px.y,
                        b.covariance_px2[(0, 0)].sqrt(),
                        b.covariance_px2[(1, 1)].sqrt(),
                        b.fit_rms,
                        b.separation
                    );
                }
            }
            if let Ok(p) = &k.position {
                extra += &format!(
                    "{},{m},9,{},{},{},{},{},{}\n",
                    e.seq,
                    p.covariance[(0, 0)],
                    p.covariance[(0, 1)],
                    p.covariance[(0, 2)],
                    p.covariance[(1, 1)],
                    p.covariance[(1, 2)],
                    p.covariance[(2, 2)]
                );
            }
        }
        csv.write(&e, &f.picture).unwrap();
    }
    csv.finish().unwrap();
    std::fs::write(format!("{}.extra", a[3]), extra).unwrap();
    println!("{:.2} ms a frame", busy * 1e3 / n as f64);
}

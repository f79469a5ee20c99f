//! Cost of a ray: `trace` and `project`, directly and through the mirror, for a rig like the sample's. One call each.

#![expect(clippy::expect_used, reason = "a bench whose rig is wrong should stop")]

use catoptra::optics::{Lens, Mirror, OpticalPath, Plane, Surface, Wall};
use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{Point2, Point3, Vector2, Vector3};
use std::hint::black_box;
use std::time::Duration;

fn rays(criterion: &mut Criterion) {
    let lens = Lens {
        focal_px: Vector2::new(2712.0, 2707.0),
        principal_point_px: Point2::new(643.7, 508.2),
        distortion: [-0.11, 0.14, 0.0006, -0.0004, 0.0],
        denominator: [0.0; 3],
    };
    let plane = |x: f64, y: f64, z: f64, offset_m| {
        Plane::new(Vector3::new(x, y, z).normalize(), offset_m).expect("a plane is made of finite numbers")
    };
    let wall = |outer| {
        let (index_outside, index_wall, index_inside) = (1.0, 1.52, 1.333);
        Surface::Wall(Wall { outer, thickness_m: 0.005, index_outside, index_wall, index_inside })
    };
    let front = wall(plane(-0.053, 0.043, -0.998, -1.264));
    let side = wall(plane(0.9986, 0.0093, -0.0523, -0.052));
    let mirror = Surface::Mirror(Mirror { plane: plane(-0.7, 0.0165, -0.714, -1.105) });
    let marker = Point3::new(-0.106, 0.027, 1.401);

    for (name, surfaces) in
        [("air", vec![]), ("mirror in air", vec![mirror]), ("direct", vec![front]), ("mirror", vec![mirror, side])]
    {
        let path = OpticalPath { lens, surfaces };
        let pixel = path.project(&marker).expect("the marker is seen");
        let mut group = criterion.benchmark_group(name);
        group.bench_function("trace", |b| b.iter(|| path.trace(black_box(&pixel))));
        group.bench_function("trace_with_jacobian", |b| b.iter(|| path.trace_with_jacobian(black_box(&pixel))));
        group.bench_function("project", |b| b.iter(|| path.project(black_box(&marker))));
        group.bench_function("project_with_jacobian", |b| b.iter(|| path.project_with_jacobian(black_box(&marker))));
    }
}

// Two seconds each: calls of microseconds need no more.
criterion_group! {
    name = benches;
    config = Criterion::default().warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_millis(1500));
    targets = rays
}
criterion_main!(benches);

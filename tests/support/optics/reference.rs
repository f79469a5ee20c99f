//! An independent implementation of the optics that shares no code with the library: Snell's law with the sines of the
//! angles, in complex numbers for derivatives by the complex step (exact to rounding, without differences); and the
//! path of least optical length (Fermat), without Snell's law.

use super::{Case, Element};
use catoptra::optics::{Lens, Surface};
use nalgebra::{Complex, DMatrix, DVector, Matrix3, Point2, Point3, Vector3};

type C = Complex<f64>;
type Vec3 = [C; 3];

fn real(v: &Vector3<f64>) -> Vec3 {
    [v.x.into(), v.y.into(), v.z.into()]
}

fn dot(a: &Vec3, b: &Vec3) -> C {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// a + s·b
fn add(a: &Vec3, s: C, b: &Vec3) -> Vec3 {
    [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]]
}

/// Brown-Conrady, written out as OpenCV's documentation does.
pub(crate) fn distort(lens: &Lens, x: C, y: C) -> [C; 2] {
    let [k1, k2, p1, p2, k3] = lens.distortion;
    let r2 = x * x + y * y;
    let radial = C::from(1.0) + r2 * k1 + r2 * r2 * k2 + r2 * r2 * r2 * k3;
    let xd = x * radial + x * y * (2.0 * p1) + (r2 + x * x * 2.0) * p2;
    let yd = y * radial + (r2 + y * y * 2.0) * p1 + x * y * (2.0 * p2);
    [xd * lens.focal_px.x + lens.principal_point_px.x, yd * lens.focal_px.y + lens.principal_point_px.y]
}

/// Interfaces that refract: unit normal, offset, index before, index behind.
fn faces(element: Element, surface: &Surface) -> Vec<(Vector3<f64>, f64, f64, f64)> {
    let Surface::Wall(w) = surface else { return Vec::new() };
    let n = w.outer.normal();
    let (outer, inner) = (w.outer.offset_m(), w.outer.offset_m() - w.thickness_m);
    if element == Element::Out {
        vec![(n, inner, w.index_inside, w.index_wall), (n, outer, w.index_wall, w.index_outside)]
    } else {
        vec![(n, outer, w.index_outside, w.index_wall), (n, inner, w.index_wall, w.index_inside)]
    }
}

/// Origin and direction after all surfaces, of the ray of a normalised image point.
pub(crate) fn trace(elements: &[Element], case: &Case, x: C, y: C) -> (Vec3, Vec3) {
    let length = (x * x + y * y + 1.0).sqrt();
    let (mut o, mut d) = ([C::from(0.0); 3], [x / length, y / length, C::from(1.0) / length]);
    for (element, surface) in elements.iter().zip(&case.path.surfaces) {
        if let Surface::Mirror(mirror) = surface {
            let (n, offset) = (real(&mirror.plane.normal()), mirror.plane.offset_m());
            o = add(&o, (-dot(&n, &o) + offset) / dot(&n, &d), &d);
            d = add(&d, dot(&n, &d) * -2.0, &n);
        }
        for (normal, offset, before, behind) in faces(*element, surface) {
            let n = real(&normal);
            o = add(&o, (-dot(&n, &o) + offset) / dot(&n, &d), &d);
            // The plane of incidence is spanned by the normal and the unit vector along the interface.
            let along = add(&d, -dot(&n, &d), &n);
            let sin_in = dot(&along, &along).sqrt();
            let sin_out = sin_in * (before / behind);
            let cos_out = (C::from(1.0) - sin_out * sin_out).sqrt();
            let forwards = dot(&n, &d).re.signum();
            d = add(&[C::from(0.0); 3], sin_out / sin_in, &along);
            d = add(&d, cos_out * forwards, &n);
        }
    }
    (o, d)
}

/// Where a point is seen, by the least optical length over the points where the path crosses the interfaces. Mirrors
/// are unfolded: everything behind one is replaced by its image, and the path goes straight on.
pub(crate) fn project(elements: &[Element], case: &Case) -> Point2<f64> {
    let mut end = case.point;
    let mut later: Vec<(Vector3<f64>, f64, f64, f64)> = Vec::new();
    for (element, surface) in elements.iter().zip(&case.path.surfaces).rev() {
        if let Surface::Mirror(mirror) = surface {
            let (m, e) = (mirror.plane.normal(), mirror.plane.offset_m());
            end -= m * (2.0 * (m.dot(&end.coords) - e));
            for (n, offset, _, _) in &mut later {
                let across = n.dot(&m);
                (*n, *offset) = (*n - m * (2.0 * across), *offset - 2.0 * e * across);
            }
        }
        later = faces(*element, surface).into_iter().chain(later).collect();
    }
    let first = least_path(&later, &end).first().copied().unwrap_or(end);
    let [u, v] = distort(&case.path.lens, (first.x / first.z).into(), (first.y / first.z).into());
    Point2::new(u.re, v.re)
}

/// The crossing points of the shortest optical path from the origin through flat interfaces to `end`: Newton on a
/// convex function with a backtracking line search.
fn least_path(faces: &[(Vector3<f64>, f64, f64, f64)], end: &Point3<f64>) -> Vec<Point3<f64>> {
    let count = faces.len();
    let frames: Vec<(Point3<f64>, Vector3<f64>, Vector3<f64>)> = faces
        .iter()
        .map(|(n, offset, _, _)| {
            let e1 = n.cross(&Vector3::new(0.31, -0.77, 0.55)).normalize();
            (Point3::from(n * *offset), e1, n.cross(&e1))
        })
        .collect();
    let points = |u: &DVector<f64>| -> Vec<Point3<f64>> {
        frames.iter().enumerate().map(|(i, (foot, e1, e2))| foot + e1 * u[2 * i] + e2 * u[2 * i + 1]).collect()
    };
    let index = |segment: usize| if segment == 0 { faces[0].2 } else { faces[segment - 1].3 };
    let chain = |u: &DVector<f64>| -> Vec<Point3<f64>> {
        std::iter::once(Point3::origin()).chain(points(u)).chain(std::iter::once(*end)).collect()
    };
    let length = |u: &DVector<f64>| -> f64 {
        chain(u).windows(2).enumerate().map(|(i, ends)| index(i) * (ends[1] - ends[0]).norm()).sum()
    };
    let mut u = DVector::zeros(2 * count);
    if count == 0 {
        return Vec::new();
    }
    for (i, (n, offset, _, _)) in faces.iter().enumerate() {
        // Start on the straight line.
        let crossing = end.coords * (offset / n.dot(&end.coords));
        let from_foot = crossing - frames[i].0.coords;
        (u[2 * i], u[2 * i + 1]) = (from_foot.dot(&frames[i].1), from_foot.dot(&frames[i].2));
    }
    for _ in 0..200 {
        let (mut gradient, mut hessian) = (DVector::zeros(2 * count), DMatrix::zeros(2 * count, 2 * count));
        for (i, ends) in chain(&u).windows(2).enumerate() {
            let v = ends[1] - ends[0];
            let l = v.norm();
            let slope = v * (index(i) / l);
            let curvature = (Matrix3::identity() - v * v.transpose() / (l * l)) * (index(i) / l);
            // The segment's ends: interface i - 1 (moves v backwards) and interface i (forwards).
            let mut movers = Vec::new();
            if i > 0 {
                movers.extend([(2 * i - 2, -frames[i - 1].1), (2 * i - 1, -frames[i - 1].2)]);
            }
            if i < count {
                movers.extend([(2 * i, frames[i].1), (2 * i + 1, frames[i].2)]);
            }
            for (a, along_a) in &movers {
                gradient[*a] += slope.dot(along_a);
                for (b, along_b) in &movers {
                    hessian[(*a, *b)] += along_a.dot(&(curvature * along_b));
                }
            }
        }
        let step = hessian.lu().solve(&gradient).expect("strictly convex");
        let mut fraction = 1.0;
        while length(&(&u - &step * fraction)) > length(&u) && fraction > 1e-6 {
            fraction *= 0.5;
        }
        // Near the minimum the length no longer tells, the gradient does: the full step is right there.
        u -= &step * if step.norm() < 1e-6 { 1.0 } else { fraction };
        if step.norm() < 1e-15 {
            break;
        }
    }
    points(&u)
}

use super::*;
use crate::log::ros2::messages::{Pose, Xyz};
use crate::sink::encoder::MessageEncoder;
use crate::testing::fixture;
use nalgebra::{Point3, UnitQuaternion, Vector3};

fn message(rig: &Rig, estimate: &crate::estimate::Estimate) -> Estimate {
    MessageEncoder::new(rig).estimate(estimate)
}

fn pose(messages: &[RosMessage], topic: usize) -> Option<&PoseWithCovarianceStamped> {
    messages.iter().filter(|message| message.topic == topic).find_map(|message| match &message.body {
        Body::Pose(pose) => Some(&**pose),
        _ => None,
    })
}

fn turn(pose: &Pose) -> UnitQuaternion<f64> {
    let q = pose.orientation;
    UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q.w, q.x, q.y, q.z))
}

#[test]
fn the_coil_points_along_its_tangent_and_the_others_say_that_they_do_not_know() {
    let rig = fixture::rig();
    let estimate = message(&rig, &fixture::complete(12, -7));
    let messages = RosEncoder::new(&rig).estimate(&estimate).unwrap();
    let coil = pose(&messages, FIRST_POSE + 1).unwrap();
    let t = estimate.tangent.unwrap().in_base.unwrap();
    assert!((turn(&coil.pose) * Vector3::z() - Vector3::new(t.x, t.y, t.z)).norm() < 1e-12);
    assert_eq!((coil.header.frame_id.as_str(), coil.header.stamp.ns()), ("catheter_base_link", -7));
    // The position's block, as in the fixture's base frame, and no correlation with the rotation.
    for (at, variance) in [(0, 1e-10), (7, 4e-10), (14, 25e-10), (3, 0.0), (18, 0.0)] {
        assert!((coil.covariance[at] - variance).abs() < 1e-20, "{at}: {}", coil.covariance[at]);
    }
    let tip = pose(&messages, FIRST_POSE + 2).unwrap();
    assert_eq!([21, 28, 35].map(|at| tip.covariance[at]), [geometry::ANY_ANGLE_RAD2; 3]);
    assert_eq!(turn(&tip.pose), UnitQuaternion::identity());
    // θ is the rotation about y.
    let theta = estimate.deflection.unwrap().theta_rad;
    let z = turn(&coil.pose) * Vector3::z();
    assert!((z.x.atan2(z.z) - theta).abs() < 1e-12);
}

#[test]
fn frames_that_lead_from_camera_to_base() {
    let rig = fixture::rig();
    let messages = RosEncoder::new(&rig).rig(5).unwrap();
    let Body::Transforms(TFMessage { transforms }) = &messages[0].body else { panic!() };
    let names: Vec<_> = transforms.iter().map(|t| (t.header.frame_id.as_str(), t.child_frame_id.as_str())).collect();
    assert_eq!(names, [("catheter_base_link", "camera_link"), ("camera_link", "camera_optical_frame")]);
    let place = |pose: &Pose| {
        let Xyz { x, y, z } = pose.position;
        Isometry3::from_parts(nalgebra::Translation3::new(x, y, z), turn(pose))
    };
    let together = place(&transforms[0].transform) * place(&transforms[1].transform);
    let p = Point3::new(0.1, -0.2, 0.9);
    assert!((together * p - rig.base.unwrap().base_from_camera * p).norm() < 1e-12);
}

#[test]
fn what_was_not_measured_has_no_message_and_is_removed_from_view() {
    let rig = fixture::rig();
    let encoder = RosEncoder::new(&rig);
    // Frame 5 lacks the coil, and thus its direction; frame 8 only the direction.
    let without_coil = encoder.estimate(&message(&rig, &fixture::eventful(5, 0))).unwrap();
    assert!(pose(&without_coil, FIRST_POSE + 1).is_none() && pose(&without_coil, FIRST_POSE).is_some());
    let Body::Joints(angles) = &without_coil[0].body else { panic!() };
    assert!(angles.position.iter().all(|angle| angle.is_nan()) && angles.position.len() == angles.name.len());
    let actions = |messages: &[RosMessage]| {
        let drawn = messages.iter().find_map(|message| match &message.body {
            Body::Markers(array) => Some(array.markers.iter().map(|m| (m.id, m.action)).collect::<Vec<_>>()),
            _ => None,
        });
        drawn.unwrap()
    };
    assert_eq!(actions(&without_coil), [(0, 0), (1, 0), (2, 2), (3, 0), (4, 2)]);
    let without_direction = encoder.estimate(&message(&rig, &fixture::eventful(8, 0))).unwrap();
    let coil = pose(&without_direction, FIRST_POSE + 1).unwrap();
    assert_eq!(coil.covariance[21], geometry::ANY_ANGLE_RAD2);
    let moved = without_direction.iter().find_map(|message| match &message.body {
        Body::Transforms(tf) => Some(tf.transforms.iter().map(|t| t.child_frame_id.clone()).collect::<Vec<_>>()),
        _ => None,
    });
    assert_eq!(moved.unwrap(), ["catheter_base_band", "catheter_tip_band"]);
}

#[test]
fn without_a_base_the_camera_is_the_root() {
    let mut rig = fixture::rig();
    rig.base = None;
    let encoder = RosEncoder::new(&rig);
    let Body::Transforms(tf) = &encoder.rig(0).unwrap()[0].body else { panic!() };
    assert_eq!(tf.transforms.len(), 1);
    let estimate = message(&rig, &fixture::complete(3, 0));
    let messages = encoder.estimate(&estimate).unwrap();
    let tip = pose(&messages, FIRST_POSE + 2).unwrap();
    assert_eq!(tip.header.frame_id, "camera_optical_frame");
    assert_eq!(tip.pose.position.z, estimate.markers[2].position.as_ref().unwrap().in_camera_m.z);
}

#[test]
fn currents_are_efforts_and_misses_are_diagnosed() {
    let current = Current { host_ns: 12, arrival_ns: 13, seq: None, current_a: vec![0.25, -1.5] };
    let Body::Joints(joints) = RosEncoder::current(&current).unwrap().body else { panic!() };
    assert_eq!((joints.name.join(" "), joints.effort), ("coil_1 coil_2".to_owned(), vec![0.25, -1.5]));
    assert!(joints.position.is_empty() && joints.header.stamp.ns() == 12);

    let rig = fixture::rig();
    let mut tally = crate::tally::Tally::new(&rig);
    for seq in 0..80 {
        tally.add(&fixture::eventful(seq, 0));
    }
    let health = MessageEncoder::new(&rig).health(&tally.totals());
    let Body::Diagnostics(array) = RosEncoder::new(&rig).health(&health).unwrap().body else { panic!() };
    let said: Vec<_> = array.status.iter().map(|s| (s.name.as_str(), s.level)).collect();
    let expected =
        [("frames", 1), ("base", 1), ("coil", 1), ("tip", 1), ("tangent", 1), ("deflection", 1), ("drift", 0)];
    assert_eq!(
        said,
        expected.map(|(name, level)| (format!("catoptra: {name}"), level)).each_ref().map(|(n, l)| (n.as_str(), *l))
    );
    let tip = &array.status[3];
    assert_eq!((tip.values[0].key.as_str(), tip.values[0].value.as_str()), ("not_seen_mirror", "8"));
}

#[test]
fn a_time_that_ros_cannot_say_is_refused() {
    let encoder = RosEncoder::new(&fixture::rig());
    let refused = encoder.rig(3_000_000_000_000_000_000).unwrap_err().to_string();
    assert!(refused.contains("3000000000 s") && refused.contains("--profile ros2"), "{refused}");
}

#[test]
fn names_that_ros_does_not_allow() {
    let names = ["base", "3rd coil", "3rd-coil", "Spitze ü", "_", "tip"];
    assert_eq!(tokens(names.into_iter()), ["base", "m3rd_coil", "m3rd_coil_2", "Spitze", "marker", "tip"]);
}

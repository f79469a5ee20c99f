//! The definitions of the ROS 2 messages as text (`ros2msg`): the fields and constants of `common_interfaces`, which
//! are unchanged from Humble to Jazzy. A schema has its own text, followed by those of all types it uses.

/// Between the texts of a schema.
const RULE: &str = "================================================================================";

/// Text of one message by its full name, without the types it uses.
fn own(name: &str) -> &'static str {
    match name {
        "builtin_interfaces/Duration" | "builtin_interfaces/Time" => "int32 sec\nuint32 nanosec\n",
        "diagnostic_msgs/DiagnosticArray" => "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n",
        "diagnostic_msgs/DiagnosticStatus" => {
            "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\nstring message\n\
             string hardware_id\ndiagnostic_msgs/KeyValue[] values\n"
        }
        "diagnostic_msgs/KeyValue" => "string key\nstring value\n",
        "geometry_msgs/Point" | "geometry_msgs/Vector3" => "float64 x\nfloat64 y\nfloat64 z\n",
        "geometry_msgs/Pose" => "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
        "geometry_msgs/PoseWithCovariance" => "geometry_msgs/Pose pose\nfloat64[36] covariance\n",
        "geometry_msgs/PoseWithCovarianceStamped" => "std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose\n",
        "geometry_msgs/Quaternion" => "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
        "geometry_msgs/Transform" => "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
        "geometry_msgs/TransformStamped" => {
            "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
        }
        "sensor_msgs/CameraInfo" => {
            "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\n\
             float64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi\n"
        }
        "sensor_msgs/CompressedImage" => "std_msgs/Header header\nstring format\nuint8[] data\n",
        "sensor_msgs/JointState" => {
            "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
        }
        "sensor_msgs/RegionOfInterest" => {
            "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n"
        }
        "sensor_msgs/TimeReference" => "std_msgs/Header header\nbuiltin_interfaces/Time time_ref\nstring source\n",
        "std_msgs/ColorRGBA" => "float32 r\nfloat32 g\nfloat32 b\nfloat32 a\n",
        "std_msgs/Header" => "builtin_interfaces/Time stamp\nstring frame_id\n",
        "std_msgs/MultiArrayDimension" => "string label\nuint32 size\nuint32 stride\n",
        "std_msgs/MultiArrayLayout" => "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset\n",
        "std_msgs/UInt8MultiArray" => "std_msgs/MultiArrayLayout layout\nuint8[] data\n",
        "tf2_msgs/TFMessage" => "geometry_msgs/TransformStamped[] transforms\n",
        "visualization_msgs/Marker" => {
            "int32 ARROW=0\nint32 CUBE=1\nint32 SPHERE=2\nint32 CYLINDER=3\nint32 LINE_STRIP=4\nint32 LINE_LIST=5\n\
             int32 CUBE_LIST=6\nint32 SPHERE_LIST=7\nint32 POINTS=8\nint32 TEXT_VIEW_FACING=9\nint32 MESH_RESOURCE=10\n\
             int32 TRIANGLE_LIST=11\nint32 ARROW_STRIP=12\nint32 ADD=0\nint32 MODIFY=0\nint32 DELETE=2\n\
             int32 DELETEALL=3\nstd_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\n\
             geometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n\
             builtin_interfaces/Duration lifetime\nbool frame_locked\ngeometry_msgs/Point[] points\n\
             std_msgs/ColorRGBA[] colors\nstring texture_resource\nsensor_msgs/CompressedImage texture\n\
             visualization_msgs/UVCoordinate[] uv_coordinates\nstring text\nstring mesh_resource\n\
             visualization_msgs/MeshFile mesh_file\nbool mesh_use_embedded_materials\n"
        }
        "visualization_msgs/MarkerArray" => "visualization_msgs/Marker[] markers\n",
        "visualization_msgs/MeshFile" => "string filename\nuint8[] data\n",
        "visualization_msgs/UVCoordinate" => "float32 u\nfloat32 v\n",
        _ => "",
    }
}

/// Text of the message `name`, and of all types it uses, each once.
pub(crate) fn whole(name: &str) -> String {
    let mut all = vec![name];
    let mut at = 0;
    while let Some(name) = all.get(at) {
        for line in own(name).lines() {
            let part = line.split([' ', '[']).next().unwrap_or_default();
            if part.contains('/') && !all.contains(&part) {
                all.push(part);
            }
        }
        at += 1;
    }
    let mut text = own(name).to_owned();
    for part in all.iter().skip(1) {
        text += &format!("{RULE}\nMSG: {part}\n{}", own(part));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_has_all_that_it_is_made_of_once() {
        let text = whole("tf2_msgs/TFMessage");
        let parts: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("MSG: ")).collect();
        assert_eq!(
            parts,
            [
                "geometry_msgs/TransformStamped",
                "std_msgs/Header",
                "geometry_msgs/Transform",
                "builtin_interfaces/Time",
                "geometry_msgs/Vector3",
                "geometry_msgs/Quaternion"
            ]
        );
        for part in parts {
            assert!(!own(part).is_empty(), "{part}");
        }
        assert!(text.starts_with("geometry_msgs/TransformStamped[] transforms\n===="), "{text}");
    }
}

use super::*;
use std::fs;

const EXPECTED: CameraMatrix = CameraMatrix { fx: 585.0, fy: 586.0, cx: 320.0, cy: 240.5 };

fn camera(text: &str) -> Result<Camera> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("camera");
    fs::write(&path, text).unwrap();
    read_camera(&path)
}

fn error(text: &str) -> String {
    camera(text).unwrap_err().to_string()
}

#[test]
fn bare_numbers() {
    for text in [
        "# fx fy cx cy\n585 586 320 240.5\n",
        "585 0 320\n0 586 240.5\n0 0 1\n",
        "585 0 320 0\n0 586 240.5 0\n0 0 1 0\n0 0 0 1\n",
    ] {
        let camera = camera(text).unwrap();
        assert_eq!((camera.intrinsics, camera.distorted), (Some(EXPECTED), false), "{text}");
    }
    for text in ["585 586 320 240.5 0.1", "585 586 320 240.5 0.26 -0.95 -0.005 0.003 1.16"] {
        let camera = camera(text).unwrap();
        assert_eq!((camera.intrinsics, camera.distorted), (Some(EXPECTED), true), "{text}");
    }
    // Six numbers may be the size first or last: not guessed.
    assert!(error("640 480 585 586 320 240.5").contains("6 numbers"));
    assert!(error("585 2 320 0 586 240 0 0 1").contains("a matrix"));
    assert!(error("585 0 320 5 0 586 240.5 0 0 0 1 0 0 0 0 1").contains("a matrix"));
}

#[test]
fn json_of_open3d_is_by_columns() {
    let text = r#"{"width": 640, "height": 480, "depth_scale": 1000.0,
        "intrinsic_matrix": [585, 0, 0, 0, 586, 0, 320, 240.5, 1]}"#;
    let found = camera(text).unwrap();
    assert_eq!(found.intrinsics, Some(EXPECTED));
    assert_eq!((found.size, found.units_per_m), (Some([640.0, 480.0]), Some(1000.0)));
    let rows = r#"{"intrinsic": {"intrinsic_matrix": [[585, 0, 320], [0, 586, 240.5], [0, 0, 1]]}}"#;
    assert_eq!(camera(rows).unwrap().intrinsics, Some(EXPECTED));
    let replica =
        r#"{"camera": {"w": 1200, "h": 680, "fx": 585, "fy": 586, "cx": 320, "cy": 240.5, "scale": 6553.5}}"#;
    let found = camera(replica).unwrap();
    assert_eq!((found.intrinsics, found.units_per_m), (Some(EXPECTED), Some(6553.5)));
    assert!(error("{\"fx\": 1").contains("JSON that is damaged"));
    assert!(error("{\"depth_scale\": 0}").contains("a depth scale of 0"));
    assert!(error("{\"fx\": 1}").contains("no intrinsics under its keys (fx"));
}

/// Files as `camera_calibration_parsers`, `rostopic echo` and ROS 2 write them.
#[test]
fn yaml_of_ros() {
    let file = "image_width: 640\nimage_height: 480\ncamera_name: depth\ncamera_matrix:\n  rows: 3\n  cols: 3\n  \
                data: [585, 0, 320, 0, 586,\n         240.5, 0, 0, 1]\ndistortion_model: plumb_bob\n\
                distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0, 0, 0, 0, 0]\nprojection_matrix:\n  \
                rows: 3\n  cols: 4\n  data: [1, 0, 2, 0, 0, 1, 2, 0, 0, 0, 1, 0]\n";
    let found = camera(file).unwrap();
    assert_eq!(
        (found.intrinsics, found.size, found.distorted),
        (Some(EXPECTED), Some([640.0, 480.0]), false)
    );
    assert!(camera(&file.replace("[0, 0, 0, 0, 0]", "[0.1, 0, 0, 0, 0]")).unwrap().distorted);
    let flow = "camera_matrix: {cols: 3, data: [585.0, 0.0, 320.0,\n    0.0, 586.0, 240.5, 0.0, 0.0, 1.0], rows: 3}\n";
    assert_eq!(camera(flow).unwrap().intrinsics, Some(EXPECTED));
    let topic = "header: \n  seq: 3\nheight: 480\nwidth: 640\nD: [0.0, 0.0]\nK: [585.0, 0.0, 320.0, 0.0, 586.0, 240.5, \
                 0.0, 0.0, 1.0]\nR: [1.0, 0.0]\nroi: \n  height: 0\n  width: 0\n---\n";
    let found = camera(topic).unwrap();
    assert_eq!((found.intrinsics, found.size), (Some(EXPECTED), Some([640.0, 480.0])));
    let ros2 = "k:\n- 585.0\n- 0.0\n- 320.0\n- 0.0\n- 586.0\n- 240.5\n- 0.0\n- 0.0\n- 1.0\nr:\n- 1.0\n";
    assert_eq!(camera(ros2).unwrap().intrinsics, Some(EXPECTED));
}

#[test]
fn yaml_of_orb_slam_and_opencv() {
    let text = "%YAML:1.0\n\n# Camera\nCamera.fx: 585.0\nCamera.fy: 586.0\nCamera.cx: 320.0\nCamera.cy: 240.5\n\
                Camera.k1: 0.0\nCamera.p2: -0.002\nCamera.width: 640\nCamera.height: 480\nDepthMapFactor: 5000.0\n";
    let found = camera(text).unwrap();
    assert_eq!((found.intrinsics, found.size), (Some(EXPECTED), Some([640.0, 480.0])));
    assert_eq!((found.units_per_m, found.distorted), (Some(5000.0), true));
    let opencv = "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   \
                  data: [ 5.85e+02, 0., 3.2e+02, 0., 5.86e+02, 2.405e+02, 0., 0.,\n       1. ]\n";
    assert_eq!(camera(opencv).unwrap().intrinsics, Some(EXPECTED));
}

#[test]
fn keys_of_scannet() {
    let text = "m_versionNumber = 4\nm_sensorName = StructureSensor\nm_colorWidth = 1296\nm_colorHeight = 968\n\
                m_depthWidth = 640\nm_depthHeight = 480\nm_depthShift = 1000\n\
                m_calibrationColorIntrinsic = 1 0 2 0 0 1 2 0 0 0 1 0 0 0 0 1\n\
                m_calibrationDepthIntrinsic = 585 0 320 0 0 586 240.5 0 0 0 1 0 0 0 0 1\n";
    let found = camera(text).unwrap();
    assert_eq!((found.intrinsics, found.size), (Some(EXPECTED), Some([640.0, 480.0])));
    assert_eq!((found.units_per_m, found.distorted), (Some(1000.0), false));
}

#[test]
fn a_principal_point_outside_of_the_image_is_a_warning() {
    let camera = camera("1170 1170 648 484").unwrap();
    assert!(camera.for_images(1296, 968).unwrap().1.is_empty());
    let (same, notes) = camera.for_images(640, 480).unwrap();
    assert_eq!(same.cx, 648.0);
    assert!(notes[0].warning && notes[0].text.contains("(648, 484) lies outside"));
}

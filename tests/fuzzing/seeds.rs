//! Good files of every format. They are small, so that a change hits something relevant.

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{DynamicImage, GrayImage, ImageEncoder, ImageFormat, Luma};

pub const CONFIG: &str = include_str!("../../config/stage.toml");
pub const STAGE: &str = "[camera]\ncalibration = \"camera.toml\"\nexposure_s = 0.01\nreadout_s = 0.02\nmask = \"mask.png\"\n\
    [[stage.surface]]\nimage = \"art.png\"\nsize_m = [4.0, 3.0]\nposition_m = [0, 0, 1.5]\norientation_xyzw = [0.7071068, 0, 0, 0.7071068]\n\
    [[object]]\nname = \"cart\"\n[[object.surface]]\nphoto = \"art.png\"\ncorners_px = [[9, 9], [110, 9], [110, 80], [9, 80]]\nsize_m = [0.7, 0.7]\n\
    [tracker]\nthreads = 2\nfeatures = 800\ncoast_s = 0.2\n[filter]\nkind = \"kalman\"\npredict_s = 0.02\n[safety]\nmax_speed_m_s = 3\n\
    permitted_box_m = [[-5, -5, 0], [5, 5, 3]]\n[[output]]\nkind = \"freed\"\nto = [\"127.0.0.1:40000\"]\nrate_hz = 50\nticks = \"clock\"\n\
    [other_tracker]\nprotocol = \"freed\"\nlisten = \"0.0.0.0:40000\"\ncamera_id = 1\nzoom_range = [0, 65535]\n\
    [timecode]\nfile = \"ltc.wav\"\nchannel = 2\nrate = \"29.97df\"\nfree_wheel_s = 30.0\n\
    [[output]]\nkind = \"osc\"\nto = [\"127.0.0.1:9000\"]\n[[output.value]]\naddress = \"/x\"\nquantity = \"x\"\nclamp = [0, 1]\n\
    [recorder]\nring_s = 10\n[http]\nlisten = \"127.0.0.1:8080\"\n[log]\nlevel = \"off\"\n";
pub const CAMERA: &str = "width = 120\nheight = 90\nfx = 110.5\nfy = 111\ncx = 60.25\ncy = 44.0\nskew = 0.001\n\
    distortion = [-0.1, 0.05, 0.001, -0.002, 0.0]\nrms_px = 0.2\nimages = 20\ndate = \"2026-01-02\"\n\n\
    [uncertainty]\nfx = 1.0\nfy = 1.5\ncx = 2.0\ncy = 2.5\nskew = 0.0\ndistortion = [0.01, 0.02, 0.001, 0.001, 0.0]\n";
pub const OPENCV: &str = "%YAML:1.0\n---\ncalibration_time: \"Mon 1 Jan 2024\"\nnframes: 13\nimage_width: 640\nimage_height: 480\n\
    camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 5.34e+02, 1.068, 3.42e+02, 0.,\n       5.36e+02, 2.35e+02, 0., 0., 1. ]\n\
    distortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ -2.6e-01, -3.8e-02,\n       1.7e-03, -2.8e-04, .2 ]\n\
    avg_reprojection_error: 3.9e-01\n";
pub const ROS: &str = "image_width: 752\nimage_height: 480\ncamera_name: cam\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [435.2, 0, 367.4, 0, 435.3, 252.2, 0, 0, 1]\n\
    distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.36, 0.15, 0.001, 0.002, 0]\n";
/// The same with a window of the sensor, and with a window that is the whole sensor.
pub const ROS_ROI: &str = "image_width: 1504\nimage_height: 960\ncamera_matrix:\n  data: [870.4, 0, 734.8, 0, 870.6, 504.4, 0, 0, 1]\n\
    distortion_model: plumb_bob\ndistortion_coefficients:\n  data: [-0.36, 0.15, 0.001, 0.002, 0]\nbinning_x: 2\nbinning_y: 2\n\
    roi:\n  x_offset: 160\n  y_offset: 90\n  height: 360\n  width: 640\n  do_rectify: false\n";
pub const ROS_WHOLE: &str = "image_width: 752\nimage_height: 480\ncamera_matrix:\n  data: [435.2, 0, 367.4, 0, 435.3, 252.2, 0, 0, 1]\n\
    distortion_model: plumb_bob\ndistortion_coefficients:\n  data: [-0.36, 0.15, 0.001, 0.002, 0]\nbinning_x: 0\nbinning_y: 1\n\
    roi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}\n";
pub const KALIBR: &str = "cam0:\n  camera_model: pinhole\n  distortion_coeffs: [-0.28, 0.07, 0.0002, 0.00002]\n  distortion_model: radtan\n  \
    intrinsics: [458.654, 457.296, 367.215, 248.375]\n  resolution: [752, 480]\n  rostopic: /cam0/image_raw\n";
pub const BOUGUET: &str = "% Focal length:\nfc = [ 657.462 ; 657.945 ];\ncc = [ 303.137 ; 242.569 ];\nalpha_c = 0.0004;\n\
    kc = [ -0.2553 ; 0.1275 ; -0.0002 ; 0.00003 ; 0.000 ]; % distortion\nfc_error = [ 0.317 ; 0.340 ];\ncc_error = [ 0.645 ; 0.591 ];\n\
    alpha_c_error = 0.0001;\nkc_error = [ 0.0027 ; 0.0107 ; 0.0001 ; 0.0001 ; 0.0 ];\nnx = 640;\nny = 480;\nn_ima = 20;\nomc_1 = [ 1.654 ; NaN ; -0.669 ];\n";
/// The description of a recording.
pub const ABOUT: &str = "program = \"stagepose 0.1.0\"\nbegun_utc = \"2026-01-02T10:00:00Z\"\nconfig = \"config/stage.toml\"\n\
    learnt = \"stagepose learnt camera 2\\nreadout_s 0.0201 0.0002\\nexposure_s 0.012 0.001\\ncurve 0.5 1.0 2.0 3.0 2.0 1.0 -1.0\\n\"\n[clock]\nmonotonic_ns = 33333333\n\
    utc_ns = 1767225600000000000\n[camera]\nname = \"cam\"\nwidth = 120\nheight = 90\nformat = \"MJPG\"\nfps = 30.0\nexposure_s = 0.01\n[camera.controls]\n\
    gain = 3\n";
pub const STAMPS: &str = "#timestamp [ns],filename\n0,000000.png\n33333333,000001.png\n66666666,000002.png\n99999999,000003.png\n";

/// The same in milliseconds, for which the unit is ambiguous.
pub const STAMPS_MS: &str = "#timestamp [ns],filename\n0,000000.png\n33,000001.png\n66,000002.png\n100,000003.png\n";
/// Pose records, with and without a pose.
pub const POSES: &str = "{\"sequence\":0,\"timestamp_ns\":0,\"state\":\"searching\",\"pose\":null,\"objects\":[]}\n\
    {\"sequence\":1,\"timestamp_ns\":33333333,\"state\":\"tracking\",\"pose\":{\"position_m\":[0.1,-4.0,1.5],\"orientation_xyzw\":[-0.6,0.0,0.0,0.8]},\
    \"measured\":null,\"covariance\":null,\"objects\":[{\"name\":\"prop\",\"state\":\"tracking\",\"pose\":{\"position_m\":[0,0,0],\
    \"orientation_xyzw\":[0,0,0,1]},\"covariance\":null}]}\n\
    {\"sequence\":2,\"timestamp_ns\":66666666,\"state\":\"coasting\",\"pose\":{\"position_m\":[0.2,-4.0,1.5],\"orientation_xyzw\":[-0.6,0.0,0.0,0.8]}}\n";
/// The timecode of a recording.
pub const TIMECODE: &str = "#timestamp [ns],timecode,fraction of the frame,rate,state,seconds without\n\
    0,01:02:03:04,0.250000,25,locked,0.000\n33333333,01:02:03;05,0.083333,29.97df,free-wheeling,1.250\n";
/// What was learnt about a camera.
pub const LEARNT: &str = "stagepose learnt camera 2\nreadout_s 0.0201 0.0002\nexposure_s 0.012 0.001\ncurve 0.5 1.0 2.0 3.0 2.0 1.0 -1.0\n";
/// Log of ffmpeg for a video with a rotation, and for its first picture.
pub const FFMPEG_LOG: &str = "[info] ffmpeg version 5.1.9-0+deb12u1 Copyright (c) 2000-2026 the FFmpeg developers\n\
    [info] Input #0, mov,mp4,m4a,3gp,3g2,mj2, from 'file:a.mp4':\n\
    [info]   Stream #0:0[0x1](und): Video: h264 (High) (avc1 / 0x31637661), yuv420p(tv, progressive), 640x360, 29.97 fps, 30 tbr\n\
    [info]     Side data:\n[info]       displaymatrix: rotation of 90.00 degrees\n\
    [Parsed_showinfo_0 @ 0x5] [info] config in time_base: 1/15360, frame_rate: 30/1\n\
    [Parsed_showinfo_0 @ 0x5] [info] n:   0 pts:    512 pts_time:0.033 fmt:yuv420p sar:1/1 s:640x360 i:P iskey:1\n\
    [info] Output #0, null, to 'pipe:':\n[info]       displaymatrix: rotation of -90.00 degrees\n\
    [mov,mp4 @ 0x6] [error] stream 0, offset 0x30: partial file\n";

/// Returns a text in UTF-16 of both byte orders, with and without a byte order mark.
pub fn utf16s(text: &str) -> Vec<Vec<u8>> {
    let (little, big) = (u16::to_le_bytes as fn(u16) -> [u8; 2], u16::to_be_bytes as fn(u16) -> [u8; 2]);
    let body = |bytes: fn(u16) -> [u8; 2]| text.encode_utf16().flat_map(bytes).collect::<Vec<u8>>();
    vec![[&[0xFF, 0xFE], &body(little)[..]].concat(), [&[0xFE, 0xFF], &body(big)[..]].concat(), body(little), body(big)]
}

/// Returns binary glTF: one with everything that is read, and one with binary data behind its
/// description.
pub fn glbs() -> Vec<Vec<u8>> {
    let glb = |text: &str, behind: &[u8]| {
        let text = format!("{text:<width$}", width = text.len().next_multiple_of(4));
        let words = [0x4654_6C67, 2, (20 + text.len() + behind.len()) as u32, text.len() as u32, 0x4E4F_534A];
        [&words.map(u32::to_le_bytes).concat(), text.as_bytes(), behind].concat()
    };
    let whole = r#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":4},{"uri":"data:,AAAA"}],"images":[{"bufferView":0}],
        "extensionsUsed":["KHR_materials_unlit"],"extensionsRequired":[],"nodes":[{"mesh":0,"extras":{"deep":[[[1]]]}}]}"#;
    vec![glb(whole, b""), glb(r#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":4}]}"#, b"\x04\0\0\0BIN\0abcd")]
}

/// Returns the shape of a surface of 4 x 3 m with this picture: one interval each way, and one mode
/// of deviation.
pub fn shape(picture: &GrayImage) -> String {
    let size = [picture.width(), picture.height()].map(u32::to_le_bytes).concat();
    let mark =
        size.iter().chain(picture.as_raw()).fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(*b)).wrapping_mul(0x0100_0000_01b3));
    let (heights, stretches) = ([0.001; 16], [[0.0, 0.0001]; 16]);
    format!(
        "picture = \"{mark:016x}\"\nsize_m = [4.0, 3.0]\n[height]\nintervals = [1, 1]\nmetres = {heights:?}\n[stretch]\nintervals = [1, 1]\n\
         metres = {stretches:?}\n[[way]]\nheight_m = {heights:?}\nstretch_m = {stretches:?}\n"
    )
}

/// Returns a picture with enough corners to be tracked.
pub fn picture(width: u32, height: u32) -> GrayImage {
    GrayImage::from_fn(width, height, |x, y| {
        let block = (x / 7).wrapping_mul(0x9E37_79B9) ^ (y / 6).wrapping_mul(0x85EB_CA6B);
        Luma([(block.wrapping_mul(0xC2B2_AE35) >> 24) as u8])
    })
}

/// Returns EXIF with a camera make and a rotation.
fn exif() -> Vec<u8> {
    b"II*\0\x08\0\0\0\x02\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\x0F\x01\x02\0\x04\0\0\0cam\0\0\0\0\0".to_vec()
}

pub fn pngs() -> Vec<Vec<u8>> {
    let grey = DynamicImage::ImageLuma8(picture(48, 32));
    let mut turned = Vec::new();
    let mut encoder = PngEncoder::new(&mut turned);
    encoder.set_exif_metadata(exif()).expect("PNG takes EXIF");
    grey.write_with_encoder(encoder).expect("a PNG");
    let forms = [grey.clone(), grey.to_rgb8().into(), grey.to_rgba16().into(), grey.to_luma_alpha8().into()];
    forms.iter().map(|form| encoded(form, ImageFormat::Png)).chain([turned]).collect()
}

pub fn jpegs() -> Vec<Vec<u8>> {
    let grey = DynamicImage::ImageLuma8(picture(48, 32));
    let mut turned = Vec::new();
    let mut encoder = JpegEncoder::new_with_quality(&mut turned, 90);
    encoder.set_exif_metadata(exif()).expect("JPEG takes EXIF");
    grey.write_with_encoder(encoder).expect("a JPEG");
    vec![encoded(&grey, ImageFormat::Jpeg), encoded(&grey.to_rgb8().into(), ImageFormat::Jpeg), turned]
}

/// Returns JPEGs cut after their EXIF, so that changes hit it, and the rest of the file.
pub fn exif_heads() -> (Vec<Vec<u8>>, Vec<u8>) {
    let turned = jpegs().swap_remove(2);
    let block = exif();
    let end = turned.windows(block.len()).position(|w| w == block).expect("the EXIF is in it") + block.len();
    (vec![turned[..end].to_vec()], turned[end..].to_vec())
}

pub fn pnms() -> Vec<Vec<u8>> {
    let grey = DynamicImage::ImageLuma8(picture(12, 8));
    let (pgm, ppm) = (encoded(&grey, ImageFormat::Pnm), encoded(&grey.to_rgb8().into(), ImageFormat::Pnm));
    let plain = b"P2\n3 2\n255\n1 2 3\n4 5 6\n".to_vec();
    vec![
        pgm,
        ppm,
        plain,
        b"P1\n3 2\n1 0 1\n0 1 0\n".to_vec(),
        b"P7\nWIDTH 2\nHEIGHT 1\nDEPTH 1\nMAXVAL 255\nTUPLTYPE GRAYSCALE\nENDHDR\nab".to_vec(),
    ]
}

pub fn y4ms() -> Vec<Vec<u8>> {
    let luma = picture(16, 8).into_raw();
    let clip = |head: &str, chroma: usize| {
        let frame = [&b"FRAME\n"[..], &luma, &vec![128; chroma]].concat();
        [head.as_bytes(), &frame.repeat(3)].concat()
    };
    vec![clip("YUV4MPEG2 W16 H8 F30000:1001 Ip A1:1 C420jpeg\n", 64), clip("YUV4MPEG2 W16 H8 F25:1 Cmono\n", 0)]
}

pub fn mjpegs() -> Vec<Vec<u8>> {
    vec![jpegs().concat(), jpegs()[0].repeat(4)]
}

/// Returns a RIFF with a header list, a few picture chunks and an index.
pub fn avis() -> Vec<Vec<u8>> {
    let chunk = |id: &[u8; 4], data: &[u8]| {
        let pad = vec![0; data.len() % 2];
        [&id[..], &(data.len() as u32).to_le_bytes(), data, &pad].concat()
    };
    let list = |kind: &[u8; 4], inside: &[u8]| chunk(b"LIST", &[&kind[..], inside].concat());
    let mut main = vec![0; 56];
    main[..4].copy_from_slice(&40_000_u32.to_le_bytes());
    let mut stream = vec![0; 56];
    stream[..8].copy_from_slice(b"vidsMJPG");
    stream[20..24].copy_from_slice(&1_u32.to_le_bytes());
    stream[24..28].copy_from_slice(&25_u32.to_le_bytes());
    let mut format = vec![0; 40];
    format[..4].copy_from_slice(&40_u32.to_le_bytes());
    format[16..20].copy_from_slice(b"MJPG");
    let headers =
        list(b"hdrl", &[chunk(b"avih", &main), list(b"strl", &[chunk(b"strh", &stream), chunk(b"strf", &format)].concat())].concat());
    let pictures: Vec<u8> = jpegs().iter().flat_map(|jpeg| chunk(b"00dc", jpeg)).collect();
    let inside = [&b"AVI "[..], &headers, &list(b"movi", &pictures), &chunk(b"idx1", &[0; 48])].concat();
    vec![chunk(b"RIFF", &inside)]
}

pub fn encoded(picture: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut bytes, format).expect("a picture that can be encoded");
    bytes.into_inner()
}

/// A TUM trajectory.
pub const TUM: &str = "# t tx ty tz qx qy qz qw\n1.5 0.1 -4 1.6 -0.7071068 0 0 0.7071068\n1.54 0.1 -4 1.6 -0.7068 0.02 0.02 0.7068\n";
/// Pose records.
pub const RECORD: &str = "{\"sequence\":0,\"timestamp_ns\":0,\"state\":\"searching\",\"pose\":null,\"measured\":null}\n\
    {\"sequence\":1,\"timestamp_ns\":40000000,\"state\":\"tracking\",\"pose\":{\"position_m\":[0,-4,0],\"orientation_xyzw\":[0,0,0,1]}}\n";

/// An OpenTrackIO sample in a capture file of libpcap.
pub fn opentrackio_capture() -> Vec<u8> {
    let text = br#"{"sourceId":"a","transforms":[{"translation":{"x":1,"y":-4,"z":1.5},"rotation":{"pan":30,"tilt":-5,"roll":1}}]}"#;
    let packet =
        stagepose::protocols::opentrackio::datagram(stagepose::protocols::opentrackio::Encoding::Json, 1, text).expect("short enough");
    let length = packet.len() as u32;
    let mut bytes = [0xA1B2_3C4D_u32.to_le_bytes().as_slice(), &[0; 20]].concat();
    [1, 0, length, length].iter().for_each(|n: &u32| bytes.extend(n.to_le_bytes()));
    bytes.extend(packet);
    bytes
}

/// Two FreeD packets in a capture file of libpcap.
pub fn freed_capture() -> Vec<u8> {
    let mut bytes = [0xA1B2_C3D4_u32.to_le_bytes().as_slice(), &[0; 20]].concat();
    for seconds in [5_u32, 6] {
        [seconds, 40_000, 71, 71].iter().for_each(|n| bytes.extend(n.to_le_bytes()));
        bytes.extend([0; 42]);
        bytes.extend(stagepose::protocols::freed::FreedPacket::default().encode().0);
    }
    bytes
}

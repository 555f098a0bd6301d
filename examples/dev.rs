use nalgebra::*;
use stagepose::camera::*;
use stagepose::frame::Frame;
use stagepose::geometry::*;
use stagepose::track::*;
use stagepose::*;
use std::io::Write;
fn f(v: &serde_json::Value) -> f64 {
    v.as_f64().unwrap()
}
fn main() {
    tracing_subscriber::fmt().with_env_filter(tracing_subscriber::EnvFilter::from_default_env()).with_writer(std::io::stderr).init();
    let a: Vec<String> = std::env::args().collect();
    let clip = std::path::PathBuf::from(&a[1]);
    let out = &a[2];
    let stagedir = a.get(3).map(std::path::PathBuf::from).unwrap_or(clip.clone());
    let threads = a.get(4).map(|s| s.parse().unwrap()).unwrap_or(1);
    let c: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(clip.join("camera.json")).unwrap()).unwrap();
    let d = &c["dist"];
    let cam = CameraModel::new(Intrinsics {
        width: f(&c["width"]) as u32,
        height: f(&c["height"]) as u32,
        fx: f(&c["fx"]),
        fy: f(&c["fy"]),
        cx: f(&c["cx"]),
        cy: f(&c["cy"]),
        skew: f(&c["skew"]),
        distortion: [f(&d[0]), f(&d[1]), f(&d[2]), f(&d[3]), f(&d[4])],
    })
    .unwrap();
    let s: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(stagedir.join("surfaces.json")).unwrap()).unwrap();
    let mut stage = BodySpec { name: "stage".into(), surfaces: vec![] };
    let mut objects = vec![];
    for r in s.as_array().unwrap() {
        let img = image::open(stagedir.join(r["image"].as_str().unwrap())).unwrap().to_luma8();
        let q = r.get("orientation_xyzw");
        let p = r.get("position_m");
        let pose = if let Some(q) = q {
            Pose::new(UnitQuaternion::from_quaternion(Quaternion::new(f(&q[3]), f(&q[0]), f(&q[1]), f(&q[2]))), {
                let p = p.unwrap();
                Vector3::new(f(&p[0]), f(&p[1]), f(&p[2]))
            })
        } else {
            Pose::identity()
        };
        let sp =
            SurfaceSpec::from_artwork(r["image"].as_str().unwrap().into(), img, [f(&r["size_m"][0]), f(&r["size_m"][1])], pose).unwrap();
        if r["body"] == "stage" {
            stage.surfaces.push(sp)
        } else {
            objects.push(BodySpec { name: r["body"].as_str().unwrap().into(), surfaces: vec![sp] })
        }
    }
    let t0 = std::time::Instant::now();
    let mut t = Tracker::new(TrackerSetup {
        camera: cam,
        exposure_s: 0.,
        readout_s: std::env::var("READOUT").map(|v| v.parse().unwrap()).unwrap_or(0.),
        mask: None,
        stage,
        objects,
        settings: TrackerSettings { threads, ..Default::default() },
    });
    eprintln!("setup {:?}", t0.elapsed());
    let mut o = std::fs::File::create(out).unwrap();
    let (mut acq, mut al, mut tot) = (vec![], vec![], vec![]);
    for (k, l) in std::fs::read_to_string(clip.join("timestamps.csv")).unwrap().lines().skip(1).enumerate() {
        let (ts, name) = l.split_once(',').unwrap();
        let image = image::open(clip.join("frames").join(name)).unwrap().to_luma8();
        let s = t.track(&Frame { image, timestamp_ns: ts.parse().unwrap(), sequence: k as u64 });
        acq.push(s.times.acquire_ms);
        al.push(s.times.align_ms);
        tot.push(s.times.acquire_ms + s.times.align_ms + s.times.pose_ms);
        writeln!(o, "{}", s.to_json_line()).unwrap();
    }
    for v in [&mut acq, &mut al, &mut tot] {
        v.sort_by(f64::total_cmp);
    }
    let p = |v: &Vec<f64>, q: f64| v[((v.len() - 1) as f64 * q) as usize];
    println!(
        "acquire p50 {:.1} align p50 {:.1} total p50 {:.1} p95 {:.1} max {:.1}",
        p(&acq, 0.5),
        p(&al, 0.5),
        p(&tot, 0.5),
        p(&tot, 0.95),
        p(&tot, 1.0)
    );
}

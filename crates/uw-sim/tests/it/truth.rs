//! Truth of the independent samples (their README says how it is stored): rigs, scenes, exact stripes, images.

use nalgebra::{Matrix3, Rotation3, Unit, Vector2, Vector3};
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};
use uw_geom::{Camera, Distortion, Fan, Galvo, Medium, Port, Rigid, Scanner, galvo_frame};
use uw_sim::shape::{Holes, Revolution};
use uw_sim::{Ambient, Beam, Instrument, Lens, Object, Scene, Sensor, Shape, Surface, Texture, Water};

/// The samples' folder, if it is there; says so where it is not.
pub fn folder() -> Option<PathBuf> {
    let found = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/samples/public");
    if !found.is_dir() {
        println!("skipped: no samples beside the repository");
    }
    found.is_dir().then_some(found)
}

pub fn read(name: &str) -> Option<Value> {
    let path = folder()?.join(format!("truth/{name}.json"));
    Some(serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap())
}

fn number(v: &Value) -> f64 {
    v.as_f64().unwrap()
}

fn numbers(v: &Value) -> Vec<f64> {
    v.as_array().unwrap().iter().map(number).collect()
}

fn vector(v: &Value) -> Vector3<f64> {
    Vector3::from_column_slice(&numbers(v))
}

fn rows(v: &Value) -> Matrix3<f64> {
    let rows: Vec<f64> = v.as_array().unwrap().iter().flat_map(numbers).collect();
    Matrix3::from_row_slice(&rows)
}

/// The true instrument of a sample, with a clean lens and sensor.
pub fn instrument(truth: &Value) -> Instrument {
    let rig = &truth["rig"];
    let (camera, laser, galvo) = (&rig["camera"], &rig["laser"], &rig["galvo"]);
    let k = rows(&camera["matrix"]);
    let d = numbers(&camera["distortion_k1_k2_p1_p2_k3"]);
    let reference_v = number(&galvo["reference_v"]);
    let (axis_point, axis) =
        (vector(&galvo["axis_point_mm"]), Unit::new_normalize(vector(&galvo["axis_direction"])));
    let [slope, c2, c3] = ["degrees_per_volt", "c2", "c3"].map(|key| number(&galvo[key]));
    let at = |v: f64| (v * (slope + v * (c2 + v * c3))).to_radians();
    let mirror_normal =
        Rotation3::from_axis_angle(&axis, at(reference_v)) * vector(&galvo["mirror_normal_at_0v"]);
    let mirrored = |v: Vector3<f64>| v - mirror_normal * 2.0 * v.dot(&mirror_normal);
    let fan_normal = mirrored(vector(&laser["fan_normal"]));
    let (origin_mm, axes) = galvo_frame(&axis_point, &axis, &fan_normal, &Vector3::z()).unwrap();
    let apex = axis_point + mirrored(vector(&laser["apex_mm"]) - axis_point) - origin_mm;
    let (normal, m) = (axes.transpose() * fan_normal, axes.transpose() * mirror_normal);
    let tilt_rad = (normal.x / normal.y).atan();
    // The fan's middle: from z towards normal × z.
    let centre = axes.transpose() * mirrored(vector(&laser["fan_centre"]));
    let (s, c) = tilt_rad.sin_cos();
    let across = Vector3::new(s, c, 0.0).cross(&Vector3::z());
    let port = |p: &Value, distance_mm: f64| {
        let glass = Medium::of_index(number(&p["index"]));
        Port::new(vector(&p["normal"]).normalize(), distance_mm, number(&p["thickness_mm"]), glass).unwrap()
    };
    let laser_window = vector(&laser["port"]["normal"]).normalize();
    let laser_distance = number(&laser["port_inner_face_offset_mm"]) - laser_window.dot(&origin_mm);
    let size = ["width", "height"].map(|key| camera[key].as_u64().unwrap() as u32);
    Instrument {
        scanner: Scanner {
            camera: Camera {
                fx: k[(0, 0)],
                fy: k[(1, 1)],
                cx: k[(0, 2)],
                cy: k[(1, 2)],
                distortion: Distortion { k1: d[0], k2: d[1], p1: d[2], p2: d[3], k3: d[4] },
            },
            camera_port: port(&camera["port"], number(&camera["port"]["distance_mm"])),
            galvo: Galvo {
                origin_mm,
                axes,
                radians_per_volt: slope.to_radians(),
                quadratic: c2.to_radians(),
                cubic: c3.to_radians(),
                reference_v,
            },
            fan: Fan {
                apex_mm: axes.transpose() * apex,
                tilt_rad,
                mirror_offset_mm: number(&galvo["mirror_offset_mm"]),
                mirror_normal_rad: m.y.atan2(m.z),
            },
            laser_port: port(&laser["port"], laser_distance),
        },
        size,
        beam: Beam {
            half_angle_rad: number(&laser["half_angle_deg"]).to_radians(),
            middle_rad: centre.dot(&across).atan2(centre.z),
            waist_radius_mm: number(&laser["waist_radius_mm"]),
            waist_at_mm: number(&laser["waist_at_mm"]),
            wavelength_nm: number(&laser["wavelength_nm"]),
            level: 1.0,
        },
        lens: Lens { blur_px: 0.6, halo: 0.0, halo_px: 0.0, vignetting: 0.0 },
        sensor: Sensor {
            bits: if size[0] > 1000 { 12 } else { 8 },
            electrons_per_dn: 0.0,
            read_noise_dn: 0.0,
            offset_dn: 0.0,
            speckle: 0.0,
            speckle_px: 0.0,
        },
    }
}

fn pose<B>(v: &Value) -> Rigid<uw_geom::frame::Camera, B> {
    Rigid::from_matrix(&rows(&v["rotation"]), vector(&v["translation_mm"]))
}

fn water(truth: &Value) -> Water {
    let medium = Medium::of_index(number(&truth["rig"]["medium_index"]));
    Water {
        laser: medium,
        ambient: medium,
        attenuation_per_mm: number(&truth["attenuation_per_mm"]),
        backscatter_per_mm: 0.0,
    }
}

fn scene_of(truth: &Value, objects: Vec<Object>) -> Scene {
    Scene {
        objects,
        water: water(truth),
        ambient: Ambient { laser_off: 0.0, laser_on: 0.0 },
        instrument_velocity_mm_s: Vector3::zeros(),
        seed: 1,
    }
}

/// The scene of a scan, without gloss: the samples' own is another.
pub fn scene(truth: &Value) -> Scene {
    let mut objects = Vec::new();
    for o in truth["objects"].as_array().unwrap() {
        let mut texture = Texture::Plain;
        let shape = match o["kind"].as_str().unwrap() {
            "sphere" => Shape::Sphere { radius_mm: number(&o["radius_mm"]) },
            "box" => Shape::Block { half_mm: numbers(&o["half_sizes_mm"]).try_into().unwrap() },
            "floor" => {
                texture = Texture::Tiles {
                    pitch_mm: number(&o["tile_mm"]) + number(&o["grout_mm"]),
                    joint_mm: number(&o["grout_mm"]),
                    dark: 0.2,
                };
                Shape::Plane
            }
            "revolution" => Shape::Revolution(Revolution {
                profile_rz_mm: o["profile_rz_mm"]
                    .as_array()
                    .unwrap()
                    .iter()
                    .map(|p| numbers(p).try_into().unwrap())
                    .collect(),
                holes: o.get("holes").filter(|h| h.is_object()).map(|h| Holes {
                    count: h["n"].as_u64().unwrap() as u32,
                    circle_mm: number(&h["circle"]),
                    radius_mm: number(&h["radius"]),
                    mouth_mm: number(&h["mouth"]),
                    floor_mm: number(&h["floor"]),
                }),
            }),
            other => panic!("{other} is not among our shapes"),
        };
        let surface = Surface { texture, ..Surface::matt(number(&o["albedo"])) };
        objects.push(Object::fixed(o["name"].as_str().unwrap(), shape, pose(o), surface));
    }
    scene_of(truth, objects)
}

/// The chessboard of a pose, half a square of margin around its squares.
pub fn board(truth: &Value, pose_number: usize) -> Scene {
    let square_mm = number(&truth["square_mm"]);
    let inner: Vec<u32> = numbers(&truth["inner_corners"]).iter().map(|n| *n as u32).collect();
    let shape = Shape::Rectangle {
        from_mm: [-1.5 * square_mm; 2],
        to_mm: [0, 1].map(|k| (f64::from(inner[k]) + 0.5) * square_mm),
    };
    let texture = Texture::Chessboard { inner_corners: [inner[0], inner[1]], square_mm, dark: 0.05 };
    let surface = Surface { texture, ..Surface::matt(0.9) };
    let object = Object::fixed("board", shape, pose(&truth["board_poses"][pose_number]), surface);
    let mut scene = scene_of(truth, vec![object]);
    scene.ambient.laser_off = 0.8;
    scene
}

/// An exact stripe centre of the samples' truth.
#[derive(Clone, Copy, Debug)]
pub struct Centre {
    pub uv: Vector2<f64>,
    pub xyz: Vector3<f64>,
    pub object: usize,
    pub lit: bool,
}

/// Exact stripe centres by frame.
pub fn stripes(name: &str) -> BTreeMap<usize, Vec<Centre>> {
    let archive = std::fs::read(folder().unwrap().join(format!("truth/{name}.stripes.npz"))).unwrap();
    let columns = npz(&archive);
    let mut found: BTreeMap<usize, Vec<Centre>> = BTreeMap::new();
    for (k, frame) in columns["frame"].iter().enumerate() {
        let (uv, xyz) = (&columns["uv"][2 * k..2 * k + 2], &columns["xyz"][3 * k..3 * k + 3]);
        found.entry(*frame as usize).or_default().push(Centre {
            uv: Vector2::new(uv[0], uv[1]),
            xyz: Vector3::from_column_slice(xyz),
            object: columns["object"][k] as usize,
            lit: columns["lit"][k] > 0.0,
        });
    }
    found
}

/// The arrays of an .npz file (a ZIP archive of .npy files, deflated, found by its central directory), as numbers.
fn npz(bytes: &[u8]) -> BTreeMap<String, Vec<f64>> {
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let half = |at: usize| u16::from_le_bytes(bytes[at..at + 2].try_into().unwrap()) as usize;
    let end = bytes.windows(4).rposition(|w| w == b"PK\x05\x06").unwrap();
    let mut at = word(end + 16);
    let mut arrays = BTreeMap::new();
    for _ in 0..half(end + 10) {
        assert_eq!(&bytes[at..at + 4], b"PK\x01\x02");
        let (packed, name, local) = (word(at + 20), half(at + 28), word(at + 42));
        let file =
            std::str::from_utf8(&bytes[at + 46..at + 46 + name]).unwrap().trim_end_matches(".npy").to_owned();
        let start = local + 30 + half(local + 26) + half(local + 28);
        let mut data = Vec::new();
        flate2::read::DeflateDecoder::new(&bytes[start..start + packed]).read_to_end(&mut data).unwrap();
        arrays.insert(file, npy(&data));
        at += 46 + name + half(at + 30) + half(at + 32);
    }
    arrays
}

fn npy(data: &[u8]) -> Vec<f64> {
    let header = u16::from_le_bytes([data[8], data[9]]) as usize;
    let kind = std::str::from_utf8(&data[10..10 + header]).unwrap();
    let data = &data[10 + header..];
    if kind.contains("'<f4'") {
        data.chunks_exact(4).map(|b| f64::from(f32::from_le_bytes(b.try_into().unwrap()))).collect()
    } else if kind.contains("'<i4'") {
        data.chunks_exact(4).map(|b| f64::from(i32::from_le_bytes(b.try_into().unwrap()))).collect()
    } else {
        assert!(kind.contains("'|i1'"), "{kind}");
        data.iter().map(|b| f64::from(*b as i8)).collect()
    }
}

/// Voltage of a frame, and its image file.
pub fn frame(name: &str, truth: &Value, row: usize) -> (Option<f64>, PathBuf) {
    let frame = &truth["frames"][row];
    (
        frame.get("voltage_v").and_then(Value::as_f64),
        folder().unwrap().join(name).join(frame["file"].as_str().unwrap()),
    )
}

/// Grey values of an image file.
pub fn image(path: &Path) -> Vec<f64> {
    let image = image::open(path).unwrap().into_luma16();
    // `image` widens 8 bits to 16 by a factor of 257.
    let eight = image::open(path).unwrap().color().bytes_per_pixel() == 1;
    image.iter().map(|v| f64::from(*v) / if eight { 257.0 } else { 1.0 }).collect()
}

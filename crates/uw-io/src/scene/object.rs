//! Things in a scene.

use serde::Deserialize;

use crate::toml_file::exactly;

/// One thing: which keys it needs besides its place depends on its shape, and [`ObjectRecord::shape`] has them checked.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectRecord {
    /// Its name.
    pub name: String,
    shape: ShapeName,
    /// Its origin at time 0.
    #[serde(deserialize_with = "exactly")]
    pub position_mm: [f64; 3],
    /// Turn about the axis along this vector by its length.
    #[serde(default, deserialize_with = "exactly")]
    pub rotation_deg: [f64; 3],
    /// Velocity.
    #[serde(default, deserialize_with = "exactly")]
    pub velocity_mm_s: [f64; 3],
    /// Turn about its origin, a second.
    #[serde(default, deserialize_with = "exactly")]
    pub turn_deg_s: [f64; 3],
    /// Share of the light thrown back diffusely.
    #[serde(default = "ObjectRecord::albedo")]
    pub albedo: f64,
    /// Share thrown back about the mirror's direction.
    #[serde(default)]
    pub specular: f64,
    /// The lobe's exponent.
    #[serde(default = "ObjectRecord::shininess")]
    pub shininess: f64,
    radius_mm: Option<f64>,
    rim_radius_mm: Option<f64>,
    sides_mm: Option<Vec<f64>>,
    tile_mm: Option<f64>,
    joint_mm: Option<f64>,
    joint_albedo: Option<f64>,
    profile_rz_mm: Option<Vec<[f64; 2]>>,
    length_mm: Option<f64>,
    flange_radius_mm: Option<f64>,
    flange_mm: Option<f64>,
    radii_mm: Option<Vec<f64>>,
    distances_mm: Option<Vec<f64>>,
    stem_mm: Option<f64>,
    file: Option<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum ShapeName {
    Sphere,
    Plane,
    Box,
    Revolution,
    Cover,
    Pipe,
    ThreeBalls,
    Mesh,
}

/// Shapes, each described in its own frame, mm.
#[derive(Debug, Clone, PartialEq)]
pub enum ShapeRecord {
    /// About its origin.
    Sphere {
        /// Its radius.
        radius_mm: f64,
    },
    /// z = 0, without end or with sides about the origin.
    Plane {
        /// Sides along x and y.
        sides_mm: Option<[f64; 2]>,
        /// Pitch, joint and the joints' albedo of its tiles.
        tiles: Option<[f64; 3]>,
    },
    /// About its origin.
    Box {
        /// Its sides.
        sides_mm: [f64; 3],
    },
    /// About the z axis.
    Revolution {
        /// Corners of the profile, radius and z.
        profile_rz_mm: Vec<[f64; 2]>,
    },
    /// The sealing cover: a stepped disc about the z axis with eight holes, base at z = 0.
    Cover {
        /// Radius of its rim, to which all else is in proportion.
        rim_radius_mm: f64,
    },
    /// A pipe about the z axis with a flange about its middle.
    Pipe {
        /// Outer radius of the pipe.
        radius_mm: f64,
        /// Its length, the origin in its middle.
        length_mm: f64,
        /// Radius of the flange, and its thickness.
        flange_mm: [f64; 2],
    },
    /// Three balls on stems on a plate: A at the origin, B along x, C by the three distances; their middles in z = 0, the plate below.
    ThreeBalls {
        /// Radii of A, B and C.
        radii_mm: [f64; 3],
        /// Distances AB, AC, BC.
        distances_mm: [f64; 3],
        /// From the balls' middles to the plate.
        stem_mm: f64,
    },
    /// Triangles of an STL or PLY file.
    Mesh {
        /// The file, relative to the scene file.
        file: String,
    },
}

/// A key that is missing or wrong: its name, what is wrong, and the mend.
pub type KeyFault = (&'static str, String, String);

fn missing(key: &'static str, example: &str) -> KeyFault {
    (key, "is missing for this shape".to_owned(), format!("add a line: {key} = {example}"))
}

fn list<const N: usize>(key: &'static str, values: Option<&Vec<f64>>) -> Result<[f64; N], KeyFault> {
    let got = values.ok_or_else(|| missing(key, &format!("[{N} numbers]")))?;
    let fault = |_| (key, format!("has {} numbers", got.len()), format!("write {N}"));
    got.as_slice().try_into().map_err(fault)
}

impl ObjectRecord {
    fn albedo() -> f64 {
        0.5
    }
    fn shininess() -> f64 {
        30.0
    }

    /// Its shape.
    ///
    /// # Errors
    /// [`KeyFault`] for a key that the shape needs and has not, or has and doesn't know.
    pub fn shape(&self) -> Result<ShapeRecord, KeyFault> {
        self.only_its_own_keys()?;
        let needed = |key: &'static str, value: Option<f64>| value.ok_or_else(|| missing(key, "…"));
        Ok(match self.shape {
            ShapeName::Sphere => ShapeRecord::Sphere { radius_mm: needed("radius_mm", self.radius_mm)? },
            ShapeName::Plane => {
                let joints = |tile: f64| {
                    let joint = self.joint_mm.unwrap_or(JOINT * tile);
                    [tile, joint, self.joint_albedo.unwrap_or(JOINT_ALBEDO * self.albedo)]
                };
                let sides_mm = self.sides_mm.as_ref().map(|s| list("sides_mm", Some(s))).transpose()?;
                ShapeRecord::Plane { sides_mm, tiles: self.tile_mm.map(joints) }
            }
            ShapeName::Box => ShapeRecord::Box { sides_mm: list("sides_mm", self.sides_mm.as_ref())? },
            ShapeName::Revolution => ShapeRecord::Revolution {
                profile_rz_mm: self
                    .profile_rz_mm
                    .clone()
                    .ok_or_else(|| missing("profile_rz_mm", "[[radius, z], …]"))?,
            },
            ShapeName::Cover => ShapeRecord::Cover { rim_radius_mm: self.rim_radius_mm.unwrap_or(COVER_MM) },
            ShapeName::Pipe => ShapeRecord::Pipe {
                radius_mm: needed("radius_mm", self.radius_mm)?,
                length_mm: needed("length_mm", self.length_mm)?,
                flange_mm: [
                    needed("flange_radius_mm", self.flange_radius_mm)?,
                    needed("flange_mm", self.flange_mm)?,
                ],
            },
            ShapeName::ThreeBalls => ShapeRecord::ThreeBalls {
                radii_mm: list("radii_mm", self.radii_mm.as_ref())?,
                distances_mm: list("distances_mm", self.distances_mm.as_ref())?,
                stem_mm: self.stem_mm.unwrap_or(STEM_MM),
            },
            ShapeName::Mesh => {
                let file = self.file.clone().ok_or_else(|| missing("file", "\"part.stl\""))?;
                ShapeRecord::Mesh { file }
            }
        })
    }

    /// Refuses a key that only another shape has.
    fn only_its_own_keys(&self) -> Result<(), KeyFault> {
        use ShapeName::{Box, Cover, Mesh, Pipe, Plane, Revolution, Sphere, ThreeBalls};
        let given: [(&'static str, bool, &[ShapeName]); 14] = [
            ("radius_mm", self.radius_mm.is_some(), &[Sphere, Pipe]),
            ("rim_radius_mm", self.rim_radius_mm.is_some(), &[Cover]),
            ("sides_mm", self.sides_mm.is_some(), &[Plane, Box]),
            ("tile_mm", self.tile_mm.is_some(), &[Plane]),
            ("joint_mm", self.joint_mm.is_some(), &[Plane]),
            ("joint_albedo", self.joint_albedo.is_some(), &[Plane]),
            ("profile_rz_mm", self.profile_rz_mm.is_some(), &[Revolution]),
            ("length_mm", self.length_mm.is_some(), &[Pipe]),
            ("flange_radius_mm", self.flange_radius_mm.is_some(), &[Pipe]),
            ("flange_mm", self.flange_mm.is_some(), &[Pipe]),
            ("radii_mm", self.radii_mm.is_some(), &[ThreeBalls]),
            ("distances_mm", self.distances_mm.is_some(), &[ThreeBalls]),
            ("stem_mm", self.stem_mm.is_some(), &[ThreeBalls]),
            ("file", self.file.is_some(), &[Mesh]),
        ];
        match given.into_iter().find(|(_, given, shapes)| *given && !shapes.contains(&self.shape)) {
            Some((key, ..)) => {
                Err((key, "means nothing for this shape".to_owned(), "remove it, or mend `shape`".to_owned()))
            }
            None => Ok(()),
        }
    }
}

/// Width of a joint as a share of the tiles' pitch, and its albedo as a share of theirs.
const JOINT: f64 = 0.03;
const JOINT_ALBEDO: f64 = 0.4;
/// Rim radius of the samples' cover, mm.
const COVER_MM: f64 = 78.0;
/// From the balls' middles to the plate, mm.
const STEM_MM: f64 = 45.0;

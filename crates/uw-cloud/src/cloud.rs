//! The point cloud: positions, and the attributes that some clouds have.

use crate::error::CloudError;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

/// The frame that a cloud's coordinates refer to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Frame {
    /// The camera: x right, y down, z forward, origin at the optical centre.
    #[default]
    Camera,
    /// The galvanometer: x along its axis, z in the laser plane of the reference voltage.
    Galvo,
}

impl Frame {
    /// Returns the frame's name as files carry it: `camera` or `galvo`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Camera => "camera",
            Self::Galvo => "galvo",
        }
    }

    /// Returns the frame of this name, `None` where there is no such frame.
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Camera, Self::Galvo].into_iter().find(|frame| frame.name() == name)
    }
}

/// One measured point with all that the scanner knows of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CloudPoint {
    /// Position, mm.
    pub position_mm: [f64; 3],
    /// Brightness of the stripe, in grey levels.
    pub intensity: f32,
    /// Row of `frames.csv` that it comes from, from 0, laser-off rows counted.
    pub frame_row: u32,
    /// Stripe centre (u, v) in the raw image; (0, 0) is the centre of the top-left pixel.
    pub pixel: [f32; 2],
    /// Standard deviation along the least certain direction, mm.
    pub sigma_mm: f32,
    /// Covariance of the measurement [xx, xy, xz, yy, yz, zz], mm².
    pub covariance_mm2: [f32; 6],
    /// What of its error all points of the sweep share: its step, mm, where that is off by one standard deviation; `None` where that is not known.
    pub shared_mm: Option<[f32; 3]>,
}

/// A point cloud in millimetres: positions, and attributes that each either exist for all points or for none.
///
/// A scan has all of them ([`PointCloud::from_points`]); a file of any origin may have positions only
/// ([`PointCloud::new`]).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PointCloud {
    frame: Frame,
    positions_mm: Vec<[f64; 3]>,
    intensities: Option<Vec<f32>>,
    frame_rows: Option<Vec<u32>>,
    pixels: Option<Vec<[f32; 2]>>,
    sigmas_mm: Option<Vec<f32>>,
    covariances_mm2: Option<Vec<[f32; 6]>>,
    shared_mm: Option<Vec<[f32; 3]>>,
    normals: Option<Vec<[f32; 3]>>,
    deviations_mm: Option<Vec<f32>>,
    colors: Option<Vec<[u8; 3]>>,
}

/// Defines one attribute's reader and its checked setter.
macro_rules! attribute {
    ($field:ident, $with:ident, $type:ty, $what:literal) => {
        #[doc = concat!("Returns ", $what, ", one entry a point; `None` where the cloud has none.")]
        pub fn $field(&self) -> Option<&[$type]> {
            self.$field.as_deref()
        }

        #[doc = concat!("Returns the cloud with ", $what, ".")]
        ///
        /// # Errors
        /// [`CloudError::LengthMismatch`] unless there is one entry a point.
        pub fn $with(mut self, values: Vec<$type>) -> Result<Self, CloudError> {
            if values.len() != self.len() {
                return Err(CloudError::LengthMismatch {
                    attribute: stringify!($field),
                    needed: self.len(),
                    got: values.len(),
                });
            }
            self.$field = Some(values);
            Ok(self)
        }
    };
}

impl PointCloud {
    /// Returns a cloud of bare positions, mm, in the given frame.
    pub fn new(frame: Frame, positions_mm: Vec<[f64; 3]>) -> Self {
        Self { frame, positions_mm, ..Self::default() }
    }

    /// Returns a cloud with all attributes from measured points; of what they share where all of them tell it.
    pub fn from_points(frame: Frame, points: &[CloudPoint]) -> Self {
        Self {
            frame,
            positions_mm: points.iter().map(|p| p.position_mm).collect(),
            intensities: Some(points.iter().map(|p| p.intensity).collect()),
            frame_rows: Some(points.iter().map(|p| p.frame_row).collect()),
            pixels: Some(points.iter().map(|p| p.pixel).collect()),
            sigmas_mm: Some(points.iter().map(|p| p.sigma_mm).collect()),
            covariances_mm2: Some(points.iter().map(|p| p.covariance_mm2).collect()),
            shared_mm: points.iter().map(|p| p.shared_mm).collect(),
            ..Self::default()
        }
    }

    attribute!(intensities, with_intensities, f32, "the stripe's brightness, in grey levels");
    attribute!(frame_rows, with_frame_rows, u32, "the row of `frames.csv`, from 0");
    attribute!(pixels, with_pixels, [f32; 2], "the stripe centre (u, v) in the raw image, px");
    attribute!(
        sigmas_mm,
        with_sigmas_mm,
        f32,
        "the standard deviation along the least certain direction, mm"
    );
    attribute!(
        covariances_mm2,
        with_covariances_mm2,
        [f32; 6],
        "the measurement's covariance [xx, xy, xz, yy, yz, zz], mm²"
    );
    attribute!(
        shared_mm,
        with_shared_mm,
        [f32; 3],
        "what of the points' error they share: each one's step, mm, where that is off by one standard deviation (part of the covariance, too)"
    );
    attribute!(
        normals,
        with_normals,
        [f32; 3],
        "unit normals of the surface, of no length where it is not known"
    );
    attribute!(
        deviations_mm,
        with_deviations_mm,
        f32,
        "signed distances to a reference, mm, not a number where there is none"
    );
    attribute!(colors, with_colors, [u8; 3], "colours (red, green, blue)");

    /// Returns the cloud of some of the points, by index, with all that is known of them.
    ///
    /// # Panics
    /// An index names no point.
    pub fn selected(&self, points: &[usize]) -> Self {
        fn of<T: Copy>(values: Option<&Vec<T>>, points: &[usize]) -> Option<Vec<T>> {
            values.map(|values| points.iter().map(|&i| values[i]).collect())
        }
        Self {
            frame: self.frame,
            positions_mm: points.iter().map(|&i| self.positions_mm[i]).collect(),
            intensities: of(self.intensities.as_ref(), points),
            frame_rows: of(self.frame_rows.as_ref(), points),
            pixels: of(self.pixels.as_ref(), points),
            sigmas_mm: of(self.sigmas_mm.as_ref(), points),
            covariances_mm2: of(self.covariances_mm2.as_ref(), points),
            shared_mm: of(self.shared_mm.as_ref(), points),
            normals: of(self.normals.as_ref(), points),
            deviations_mm: of(self.deviations_mm.as_ref(), points),
            colors: of(self.colors.as_ref(), points),
        }
    }

    /// Returns the points of several clouds as one, in the first one's frame: nothing is moved. Of the attributes those that all of
    /// them have, but for frame rows and pixels, which say nothing beside another capture's.
    pub fn joined(clouds: &[Self]) -> Self {
        fn all<'a, T: Copy + 'a>(
            clouds: &'a [PointCloud],
            of: impl Fn(&'a PointCloud) -> Option<&'a [T]>,
        ) -> Option<Vec<T>> {
            let parts: Option<Vec<&[T]>> = clouds.iter().map(of).collect();
            parts.filter(|parts| !parts.is_empty()).map(|parts| parts.concat())
        }
        Self {
            frame: clouds.first().map(Self::frame).unwrap_or_default(),
            positions_mm: clouds.iter().flat_map(|c| c.positions_mm.iter().copied()).collect(),
            intensities: all(clouds, Self::intensities),
            frame_rows: None,
            pixels: None,
            sigmas_mm: all(clouds, Self::sigmas_mm),
            covariances_mm2: all(clouds, Self::covariances_mm2),
            shared_mm: all(clouds, Self::shared_mm),
            normals: all(clouds, Self::normals),
            deviations_mm: all(clouds, Self::deviations_mm),
            colors: all(clouds, Self::colors),
        }
    }

    /// Returns the frame that the coordinates refer to.
    pub fn frame(&self) -> Frame {
        self.frame
    }

    /// Returns the positions, mm.
    pub fn positions_mm(&self) -> &[[f64; 3]] {
        &self.positions_mm
    }

    /// Returns the number of points.
    pub fn len(&self) -> usize {
        self.positions_mm.len()
    }

    /// Returns whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.positions_mm.is_empty()
    }

    /// Checks that every position and every attribute is a finite number, but for deviations, which a point may be without.
    ///
    /// # Errors
    /// [`CloudError::NonFinite`] with the first that isn't.
    pub fn check_finite(&self) -> Result<(), CloudError> {
        fn check<'a, T: 'a>(
            attribute: &'static str,
            values: impl IntoIterator<Item = &'a T>,
            finite: impl Fn(&T) -> bool,
        ) -> Result<(), CloudError> {
            match values.into_iter().position(|value| !finite(value)) {
                Some(index) => Err(CloudError::NonFinite { attribute, index }),
                None => Ok(()),
            }
        }
        check("position", &self.positions_mm, |p| p.iter().all(|c| c.is_finite()))?;
        check("intensity", self.intensities.iter().flatten(), |v| v.is_finite())?;
        check("pixel", self.pixels.iter().flatten(), |v| v.iter().all(|c| c.is_finite()))?;
        check("sigma", self.sigmas_mm.iter().flatten(), |v| v.is_finite())?;
        check("covariance", self.covariances_mm2.iter().flatten(), |v| v.iter().all(|c| c.is_finite()))?;
        check("shared error", self.shared_mm.iter().flatten(), |v| v.iter().all(|c| c.is_finite()))?;
        check("normal", self.normals.iter().flatten(), |v| v.iter().all(|c| c.is_finite()))
    }

    /// Returns the lowest and the highest corner of the box around all points, mm; `None` for a cloud that is empty
    /// or has a position that is not finite.
    pub fn bounding_box_mm(&self) -> Option<([f64; 3], [f64; 3])> {
        let first = *self.positions_mm.first()?;
        let mut corners = (first, first);
        for position in &self.positions_mm {
            for (axis, &value) in position.iter().enumerate() {
                if !value.is_finite() {
                    return None;
                }
                corners.0[axis] = corners.0[axis].min(value);
                corners.1[axis] = corners.1[axis].max(value);
            }
        }
        Some(corners)
    }

    /// Returns the cloud moved rigidly into another frame: p' = R p + t, C' = R C Rᵀ.
    pub fn transformed(mut self, frame: Frame, frame_from_cloud: &Isometry3<f64>) -> Self {
        for position in &mut self.positions_mm {
            *position = (frame_from_cloud * Point3::from(*position)).coords.into();
        }
        let rotation = frame_from_cloud.rotation.to_rotation_matrix();
        for covariance in self.covariances_mm2.iter_mut().flatten() {
            *covariance = packed(&(rotation * unpacked(covariance) * rotation.transpose()));
        }
        for direction in self.normals.iter_mut().flatten().chain(self.shared_mm.iter_mut().flatten()) {
            *direction = turned(&rotation, direction);
        }
        self.frame = frame;
        self
    }

    /// Returns the position of a point as a vector, mm.
    pub(crate) fn vector(&self, index: usize) -> Vector3<f64> {
        self.positions_mm[index].into()
    }
}

/// Returns a stored direction turned.
fn turned(rotation: &nalgebra::Rotation3<f64>, direction: &[f32; 3]) -> [f32; 3] {
    let turned = rotation * Vector3::from(direction.map(f64::from));
    [turned.x as f32, turned.y as f32, turned.z as f32]
}

/// Returns the symmetric matrix of [xx, xy, xz, yy, yz, zz].
pub(crate) fn unpacked(packed: &[f32; 6]) -> Matrix3<f64> {
    let [xx, xy, xz, yy, yz, zz] = packed.map(f64::from);
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
}

/// Returns [xx, xy, xz, yy, yz, zz] of a covariance; a variance that rounding made negative, as turning a nil one does, is nil.
pub(crate) fn packed(m: &Matrix3<f64>) -> [f32; 6] {
    let variance = |at: usize| m[(at, at)].max(0.0);
    [variance(0), m[(0, 1)], m[(0, 2)], variance(1), m[(1, 2)], variance(2)].map(|value| value as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;
    use proptest::prelude::*;

    /// Covariances are stored as f32: relative rounding of entries near 1 mm², mm².
    const COVARIANCE_ROUNDING_MM2: f64 = 4e-6;

    #[test]
    fn attribute_of_another_length_is_refused() {
        let cloud = PointCloud::new(Frame::Galvo, vec![[0.0; 3]; 3]);
        assert_eq!(
            cloud.with_sigmas_mm(vec![0.1; 2]),
            Err(CloudError::LengthMismatch { attribute: "sigmas_mm", needed: 3, got: 2 })
        );
    }

    #[test]
    fn the_first_value_that_is_no_number_is_named() {
        let cloud = PointCloud::new(Frame::Camera, vec![[0.0; 3], [0.0, f64::NAN, 0.0], [f64::INFINITY; 3]]);
        assert_eq!(cloud.check_finite(), Err(CloudError::NonFinite { attribute: "position", index: 1 }));
        assert_eq!(cloud.bounding_box_mm(), None);
        let cloud = PointCloud::new(Frame::Camera, vec![[0.0; 3]; 2]);
        let cloud = cloud.with_covariances_mm2(vec![[0.0; 6], [0.0, 0.0, 0.0, 0.0, 0.0, f32::NAN]]).unwrap();
        assert_eq!(cloud.check_finite(), Err(CloudError::NonFinite { attribute: "covariance", index: 1 }));
        let cloud = PointCloud::new(Frame::Camera, vec![[0.0; 3]; 2]);
        let cloud = cloud.with_shared_mm(vec![[0.0, f32::NAN, 0.0], [0.0; 3]]).unwrap();
        let shared = CloudError::NonFinite { attribute: "shared error", index: 0 };
        assert_eq!(
            (cloud.check_finite(), crate::sample::check_positions(&cloud)),
            (Err(shared.clone()), Err(shared))
        );
    }

    #[test]
    fn bounding_box_holds_the_extremes() {
        let cloud = PointCloud::new(Frame::Camera, vec![[1.0, -2.0, 3.0], [-1.0, 5.0, 4.0], [0.0, 0.0, 9.0]]);
        assert_eq!(cloud.bounding_box_mm(), Some(([-1.0, -2.0, 3.0], [1.0, 5.0, 9.0])));
        assert_eq!(PointCloud::default().bounding_box_mm(), None);
    }

    #[test]
    fn names_of_frames_are_read_back() {
        for frame in [Frame::Camera, Frame::Galvo] {
            assert_eq!(Frame::from_name(frame.name()), Some(frame));
        }
        assert_eq!(Frame::from_name("world"), None);
    }

    #[test]
    fn points_are_selected_and_joined_with_what_is_known_of_them() {
        let cloud = PointCloud::new(Frame::Camera, vec![[0.0; 3], [1.0; 3], [2.0; 3]])
            .with_sigmas_mm(vec![0.0, 0.1, 0.2])
            .and_then(|c| c.with_colors(vec![[0; 3], [1; 3], [2; 3]]))
            .and_then(|c| c.with_frame_rows(vec![0, 1, 2]))
            .unwrap();
        let some = cloud.selected(&[2, 0]);
        assert_eq!(some.positions_mm(), [[2.0; 3], [0.0; 3]]);
        assert_eq!((some.sigmas_mm().unwrap(), some.frame_rows().unwrap()), (&[0.2, 0.0][..], &[2, 0][..]));
        let bare = some.clone().with_normals(vec![[0.0, 0.0, 1.0]; 2]).unwrap();
        let joined = PointCloud::joined(&[cloud, bare]);
        assert_eq!((joined.len(), joined.sigmas_mm().unwrap()[3]), (5, 0.2));
        assert_eq!(joined.colors().unwrap()[3], [2; 3]);
        assert!(joined.normals().is_none() && joined.frame_rows().is_none());
        assert!(PointCloud::joined(&[]).is_empty());
    }

    proptest! {
        /// A variance along a direction stays with that direction, and distances stay.
        #[test]
        fn moving_a_cloud_keeps_distances_and_variances(
            axis in prop::array::uniform3(-3.0..3.0f64),
            shift in prop::array::uniform3(-1e3..1e3f64),
            spread in prop::array::uniform3(-0.5..0.5f64),
        ) {
            let motion = Isometry3::from_parts(Vector3::from(shift).into(), UnitQuaternion::new(Vector3::from(axis)));
            let direction = Vector3::from(spread);
            let covariance = direction * direction.transpose();
            let cloud = PointCloud::new(Frame::Camera, vec![[0.0; 3], spread])
                .with_covariances_mm2(vec![packed(&covariance); 2])
                .and_then(|c| c.with_shared_mm(vec![spread.map(|c| c as f32); 2]))
                .unwrap();
            let moved = cloud.transformed(Frame::Galvo, &motion);
            prop_assert_eq!(moved.frame(), Frame::Galvo);
            let after = moved.vector(1) - moved.vector(0);
            prop_assert!((after - motion.rotation * direction).norm() < 1e-12 * 1e3);
            let step = Vector3::from(moved.shared_mm().unwrap()[1].map(f64::from));
            prop_assert!((step - motion.rotation * direction).norm() < 1e-6);
            // Whatever rounding makes of what does not vary across a ray.
            let turned = moved.covariances_mm2().unwrap()[1];
            prop_assert!([0, 3, 5].iter().all(|&k| turned[k] >= 0.0), "{turned:?}");
            let rotated = unpacked(&moved.covariances_mm2().unwrap()[0]);
            prop_assert!((rotated - after * after.transpose()).amax() < COVARIANCE_ROUNDING_MM2);
        }
    }
}

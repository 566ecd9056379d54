//! The class of a fitted shape: what all of them tell, and a list of what each tells besides.

/// Defines the class of a fitted shape. Numbers, places (three numbers) and pairs are fields of its fit; `total_…` are standard deviations with
/// the calibration's part, by their first row in the covariance.
macro_rules! shape {
    (
        $(#[doc = $doc:literal])*
        $class:ident($inner:ident) named $name:literal, distance $distance:path,
        numbers { $($(#[doc = $number_doc:literal])* $number:ident,)* }
        places { $($(#[doc = $place_doc:literal])* $place:ident,)* }
        pairs { $($(#[doc = $pair_doc:literal])* $pair:ident,)* }
        total_numbers { $($(#[doc = $total_doc:literal])* $total:ident = $row:literal,)* }
        total_places { $($(#[doc = $total_place_doc:literal])* $total_place:ident = $first:literal,)* }
        shown($fit:ident) { $shown:expr }
    ) => {
        $(#[doc = $doc])*
        #[pyclass(module = "uwscan", frozen)]
        pub struct $class {
            pub fit: $inner,
            pub common: $crate::fits::Common,
        }

        #[pymethods]
        impl $class {
            $(
                $(#[doc = $number_doc])*
                #[getter]
                fn $number(&self) -> f64 {
                    self.fit.$number
                }
            )*

            $(
                $(#[doc = $place_doc])*
                #[getter]
                fn $place<'py>(&self, py: Python<'py>) -> $crate::convert::Out<'py, f64> {
                    $crate::convert::Out::of(py, self.fit.$place.to_vec())
                }
            )*

            $(
                $(#[doc = $pair_doc])*
                #[getter]
                fn $pair(&self) -> (f64, f64) {
                    (self.fit.$pair[0], self.fit.$pair[1])
                }
            )*

            $(
                $(#[doc = $total_doc])*
                #[getter]
                fn $total(&self) -> Option<f64> {
                    self.common.total.as_ref().map(|c| $crate::fits::sigma(c, $row))
                }
            )*

            $(
                $(#[doc = $total_place_doc])*
                #[getter]
                fn $total_place<'py>(&self, py: Python<'py>) -> Option<$crate::convert::Out<'py, f64>> {
                    self.common.total.as_ref().map(|c| $crate::fits::sigmas(py, c, $first))
                }
            )*

            fn __repr__(&self) -> String {
                let $fit = &self.fit;
                $shown
            }

            #[doc = concat!("``\"", $name, "\"``")]
            #[getter]
            fn kind(&self) -> &'static str {
                $name
            }

            /// Covariance of the parameters from the points alone, float64.
            #[getter]
            fn covariance<'py>(&self, py: Python<'py>) -> PyResult<$crate::convert::Out<'py, f64>> {
                $crate::convert::Out::dense(py, &self.common.covariance)
            }

            /// Covariance of the parameters with the calibration's part, float64; None where no calibration was given.
            #[getter]
            fn covariance_total<'py>(&self, py: Python<'py>) -> PyResult<Option<$crate::convert::Out<'py, f64>>> {
                self.common.total.as_ref().map(|total| $crate::convert::Out::dense(py, total)).transpose()
            }

            /// Points that the shape was fitted to.
            #[getter]
            fn points(&self) -> usize {
                self.fit.deviations.points
            }

            /// Points rejected: farther off than their sigma and the number of points explain.
            #[getter]
            fn outliers(&self) -> usize {
                self.fit.deviations.outliers
            }

            /// Root mean square of the fitted points' orthogonal distances, mm.
            #[getter]
            fn rms_mm(&self) -> f64 {
                self.fit.deviations.rms_mm
            }

            /// Largest distance of a fitted point on the outside (of a plane: the sensor's side), mm.
            #[getter]
            fn max_outside_mm(&self) -> f64 {
                self.fit.deviations.max_outside_mm
            }

            /// Largest distance of a fitted point on the inside, mm.
            #[getter]
            fn max_inside_mm(&self) -> f64 {
                self.fit.deviations.max_inside_mm
            }

            /// All that is known of the points' distances: points, outliers, duplicates, rms_mm, max_outside_mm, max_inside_mm, scale, floor_mm.
            #[getter]
            fn statistics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, pyo3::types::PyDict>> {
                $crate::fits::statistics(py, &self.fit.deviations)
            }

            /// Which points of the cloud the shape is made of, (n,) int64; None unless ``uwscan.find_shapes`` found it.
            #[getter]
            fn point_index<'py>(&self, py: Python<'py>) -> Option<$crate::convert::Out<'py, i64>> {
                let points = self.common.points.as_ref()?;
                Some($crate::convert::Out::of(py, points.iter().map(|&i| i as i64).collect()))
            }

            /// Signed orthogonal distances of points from the shape, mm: positive outside (of a plane: on the sensor's side).
            ///
            /// Parameters
            /// ----------
            /// points_mm : array_like
            ///     (n, 3), mm, in the frame of the fitted points.
            ///
            /// Returns
            /// -------
            /// numpy.ndarray
            ///     (n,) float64, mm.
            #[pyo3(signature = (points_mm: "numpy.typing.ArrayLike") -> "numpy.typing.NDArray[numpy.float64]")]
            fn deviations_mm<'py>(&self, py: Python<'py>, points_mm: &Bound<'py, PyAny>) -> PyResult<$crate::convert::Out<'py, f64>> {
                let points: Vec<[f64; 3]> = $crate::convert::row_arrays(&$crate::convert::table("points_mm", points_mm, 3)?);
                Ok($crate::convert::Out::of(py, points.into_iter().map(|p| $distance(&self.fit, &Vector3::from(p))).collect()))
            }
        }
    };
}

pub(crate) use shape;

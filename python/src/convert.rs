//! NumPy arrays in and out: inputs are borrowed where their layout allows, outputs are owned by Python or lent by their object.

use crate::errors::{Class, error, input, type_name};
use numpy::ndarray::{ArrayView, ArrayView2, ArrayView3, Axis, Dimension, Ix2};
use numpy::{
    Element, PyArray, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyReadonlyArrayDyn, PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use std::convert::Infallible;
use std::marker::PhantomData;
use uwscan::stripe::{Pixel, StripeError, View};

/// Images of either type of pixel, borrowed.
pub enum Images<'py> {
    /// 8 bits.
    U8(PyReadonlyArrayDyn<'py, u8>),
    /// 16 bits.
    U16(PyReadonlyArrayDyn<'py, u16>),
}

impl<'py> Images<'py> {
    /// Borrows an image (h, w) or a stack of them (n, h, w).
    pub fn of(name: &str, any: &Bound<'py, PyAny>) -> PyResult<Self> {
        let py = any.py();
        let array = any.cast::<PyUntypedArray>().map_err(|_| {
            let got = type_name(any);
            error(py, Class::Dtype, format!("{name} must be a numpy array of uint8 or uint16, got {got}"))
        })?;
        if !matches!(array.ndim(), 2 | 3) {
            let got = array.shape();
            return Err(input(py, format!("{name} must have the shape (h, w) or (n, h, w), got {got:?}")));
        }
        // A pointer between two values can't be read as one: rare enough to copy.
        let aligned = if array.is_aligned() { any.clone() } else { any.call_method0("copy")? };
        let dtype = array.dtype();
        if dtype.is_equiv_to(&numpy::dtype::<u8>(py)) {
            Ok(Self::U8(aligned.extract()?))
        } else if dtype.is_equiv_to(&numpy::dtype::<u16>(py)) {
            Ok(Self::U16(aligned.extract()?))
        } else {
            Err(error(py, Class::Dtype, format!("{name} must be of uint8 or uint16, got {dtype}")))
        }
    }

    /// (n, h, w); n is `None` for one image.
    pub fn shape(&self) -> (Option<usize>, usize, usize) {
        let shape = match self {
            Self::U8(array) => array.shape(),
            Self::U16(array) => array.shape(),
        };
        match *shape {
            [n, height, width] => (Some(n), height, width),
            [height, width] => (None, height, width),
            _ => (None, 0, 0),
        }
    }
}

/// An array of two or three dimensions as a stack of images.
pub fn stack<'a, P: Element>(array: &'a PyReadonlyArrayDyn<'_, P>) -> Option<ArrayView3<'a, P>> {
    let view = array.as_array();
    let view = if view.ndim() == 2 { view.insert_axis(Axis(0)) } else { view };
    view.into_dimensionality().ok()
}

/// One image as stripes are looked for in it.
pub enum Frame<'a, P> {
    /// As it lies in Python's memory.
    Borrowed(View<'a, P>),
    /// Copied, where the pixels of a row do not follow each other or rows run backwards: the values, width and height.
    Copied(Vec<P>, usize, usize),
}

impl<'a, P: Pixel> Frame<'a, P> {
    /// Borrows an image, or copies it where its layout asks for it.
    pub fn of(image: ArrayView2<'a, P>) -> Result<Self, StripeError> {
        let (height, width) = image.dim();
        if let Some(pixels) = image.to_slice() {
            return View::packed(pixels, width, height).map(Self::Borrowed);
        }
        match (rows(image), usize::try_from(image.strides()[0])) {
            (Some(pixels), Ok(stride)) => View::new(pixels, width, height, stride).map(Self::Borrowed),
            _ => Ok(Self::Copied(image.iter().copied().collect(), width, height)),
        }
    }

    /// The image.
    pub fn view(&self) -> Result<View<'_, P>, StripeError> {
        match self {
            Self::Borrowed(view) => Ok(*view),
            Self::Copied(pixels, width, height) => View::packed(pixels, *width, *height),
        }
    }
}

/// The memory from an image's first pixel to its last, where rows are whole, in order and at least a row apart.
#[allow(unsafe_code, reason = "ndarray has no slice for rows with gaps between them")]
fn rows<P: Pixel>(image: ArrayView2<'_, P>) -> Option<&[P]> {
    let (height, width) = image.dim();
    let [down, across] = *image.strides() else { return None };
    if height == 0 || width == 0 || across != 1 || down < width as isize {
        return None;
    }
    let length = (height - 1).checked_mul(down as usize)?.checked_add(width)?;
    // SAFETY: the first and the last pixel are elements of the view, which is one allocation borrowed for as long as the slice; what lies
    // between them is part of that allocation, and whole pixels of integers, which any bits are.
    Some(unsafe { std::slice::from_raw_parts(image.as_ptr(), length) })
}

/// Borrows numbers as float64 of any shape; converts what holds other numbers.
pub fn floats<'py>(name: &str, any: &Bound<'py, PyAny>) -> PyResult<PyReadonlyArrayDyn<'py, f64>> {
    let py = any.py();
    if let Ok(array) = any.cast::<PyArrayDyn<f64>>()
        && array.is_aligned()
    {
        return Ok(array.try_readonly()?);
    }
    let numpy = py.import("numpy")?;
    let refused = |e: PyErr| input(py, format!("{name} must be an array of numbers: {}", e.value(py)));
    let array = numpy.call_method1("asarray", (any,)).map_err(refused)?;
    let dtype = array.getattr("dtype")?;
    let kind: String = dtype.getattr("kind")?.extract()?;
    // NumPy makes float64 of an empty list.
    if !matches!(kind.as_str(), "f" | "i" | "u") {
        return Err(error(py, Class::Dtype, format!("{name} must hold real numbers, got {dtype}")));
    }
    array.call_method1("astype", ("float64",))?.extract()
}

/// Borrows `columns` numbers a row: (n, columns), or a single row (columns,).
pub fn table<'py>(
    name: &str,
    any: &Bound<'py, PyAny>,
    columns: usize,
) -> PyResult<PyReadonlyArray2<'py, f64>> {
    let py = any.py();
    let array = floats(name, any)?;
    let wrong = |got: &[usize]| input(py, format!("{name} must have the shape (n, {columns}), got {got:?}"));
    match *array.shape() {
        [_, got] if got == columns => Ok(array.as_any().extract()?),
        [got] if got == columns => {
            Ok(array.call_method1("reshape", ((1, columns),))?.extract::<PyReadonlyArray2<'py, f64>>()?)
        }
        ref got => Err(wrong(got)),
    }
}

/// Borrows one number for each of `rows` rows; a single number stands for all.
pub fn column<'py>(name: &str, any: &Bound<'py, PyAny>, rows: usize) -> PyResult<PyReadonlyArray1<'py, f64>> {
    let py = any.py();
    let array = floats(name, any)?;
    match *array.shape() {
        [got] if got == rows => Ok(array.as_any().extract()?),
        [] => {
            let numpy = py.import("numpy")?;
            Ok(numpy.call_method1("broadcast_to", (array.as_any(), rows))?.call_method0("copy")?.extract()?)
        }
        ref got => Err(input(py, format!("{name} must have the shape ({rows},), got {got:?}"))),
    }
}

/// Three numbers.
pub fn triple(name: &str, any: &Bound<'_, PyAny>) -> PyResult<[f64; 3]> {
    let array = floats(name, any)?;
    match array.as_array().iter().copied().collect::<Vec<_>>()[..] {
        [x, y, z] if array.ndim() == 1 => Ok([x, y, z]),
        _ => Err(input(any.py(), format!("{name} must have the shape (3,), got {:?}", array.shape()))),
    }
}

/// The rows of an (n, N) table.
pub fn row_arrays<const N: usize>(table: &PyReadonlyArray2<'_, f64>) -> Vec<[f64; N]> {
    table.as_array().rows().into_iter().map(|row| std::array::from_fn(|i| row[i])).collect()
}

/// A type of an array's elements, as type hints name it.
pub trait Scalar: Element {
    /// `numpy.typing.NDArray[numpy.…]`
    #[cfg(feature = "stubs")]
    const HINT: pyo3::inspect::PyStaticExpr;
}

macro_rules! scalars {
    ($($type:ty => $name:literal),*) => {$(
        impl Scalar for $type {
            #[cfg(feature = "stubs")]
            const HINT: pyo3::inspect::PyStaticExpr = pyo3::type_hint_subscript!(
                pyo3::type_hint_identifier!("numpy.typing", "NDArray"),
                pyo3::type_hint_identifier!("numpy", $name)
            );
        }
    )*};
}

scalars!(bool => "bool_", f32 => "float32", f64 => "float64", u8 => "uint8", u16 => "uint16", u32 => "uint32", i64 => "int64");

/// An array for Python, its element type known to type checkers.
pub struct Out<'py, T>(Bound<'py, PyAny>, PhantomData<T>);

impl<'py, T: Scalar> Out<'py, T> {
    /// Any array of that type.
    pub fn new<D: Dimension>(array: Bound<'py, PyArray<T, D>>) -> Self {
        Self(array.into_any(), PhantomData)
    }

    /// A vector's memory as a one-dimensional array.
    pub fn of(py: Python<'py>, values: Vec<T>) -> Self {
        Self::new(PyArray::from_vec(py, values))
    }

    /// A vector of rows as an (n, N) array, in the same memory.
    pub fn rows<const N: usize>(py: Python<'py>, rows: Vec<[T; N]>) -> PyResult<Self> {
        let shape = [rows.len(), N];
        Ok(Self::new(PyArray::from_vec(py, rows.into_flattened()).reshape(shape)?))
    }

    /// Matrices one upon the other, (k, N, N).
    pub fn matrices<const N: usize>(py: Python<'py>, matrices: Vec<[[T; N]; N]>) -> PyResult<Self> {
        let shape = [matrices.len(), N, N];
        let values = matrices.into_flattened().into_flattened();
        Ok(Self::new(PyArray::from_vec(py, values).reshape(shape)?))
    }

    /// A matrix.
    pub fn matrix<const N: usize>(py: Python<'py>, rows: &[[T; N]]) -> PyResult<Self>
    where
        T: Copy,
    {
        Self::rows(py, rows.to_vec())
    }

    /// The array itself.
    pub fn into_inner(self) -> Bound<'py, PyAny> {
        self.0
    }

    /// Something that is known to be such an array.
    pub fn known(array: Bound<'py, PyAny>) -> Self {
        Self(array, PhantomData)
    }
}

/// The rows of a pose's matrix, (4, 4).
pub fn pose_rows(pose: &nalgebra::Isometry3<f64>) -> [[f64; 4]; 4] {
    let m = pose.to_homogeneous();
    std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
}

/// The rows of a covariance of six.
pub fn six_rows(m: &nalgebra::Matrix6<f64>) -> [[f64; 6]; 6] {
    std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
}

impl<'py> Out<'py, f64> {
    /// nalgebra's matrix, row by row.
    pub fn dense(py: Python<'py>, matrix: &nalgebra::DMatrix<f64>) -> PyResult<Self> {
        let values: Vec<f64> = matrix.transpose().as_slice().to_vec();
        Ok(Self::new(PyArray::from_vec(py, values).reshape([matrix.nrows(), matrix.ncols()])?))
    }
}

impl<'py, T: Scalar> IntoPyObject<'py> for Out<'py, T> {
    type Target = PyAny;
    type Output = Bound<'py, PyAny>;
    type Error = Infallible;
    #[cfg(feature = "stubs")]
    const OUTPUT_TYPE: pyo3::inspect::PyStaticExpr = T::HINT;

    fn into_pyobject(self, _: Python<'py>) -> Result<Self::Output, Self::Error> {
        Ok(self.0)
    }
}

/// An object's own memory as a read-only array that keeps the object alive. The object must never change or move that memory: only
/// frozen classes lend.
#[allow(unsafe_code, reason = "no copy of millions of points for each look at them")]
pub fn lend<'py, T: Scalar, D: Dimension>(
    owner: &Bound<'py, PyAny>,
    memory: &ArrayView<'_, T, D>,
) -> PyResult<Out<'py, T>> {
    // SAFETY: the array's base is the owner, which keeps the memory where it is and unchanged for as long as it lives.
    let array = unsafe { PyArray::borrow_from_array(memory, owner.clone()) };
    // By Python's own setter: a borrow for writing would clash with a call that reads the same memory in another thread.
    array.call_method1("setflags", (false,))?;
    Ok(Out::new(array))
}

/// Rows of an object as [`lend`] lends them.
pub fn lend_rows<'py, T: Scalar, const N: usize>(
    owner: &Bound<'py, PyAny>,
    rows: &[[T; N]],
) -> PyResult<Out<'py, T>> {
    let view = ArrayView::<T, Ix2>::from_shape((rows.len(), N), rows.as_flattened());
    lend(owner, &view.map_err(|e| input(owner.py(), e.to_string()))?)
}

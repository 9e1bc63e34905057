//! Arrays and numbers from Python. Every function names the argument in its error.

use crate::errors::refused;
use numpy::{
    Element, IntoPyArray, PyArray1, PyArray2, PyArrayDescr, PyArrayDyn, PyArrayMethods,
    PyUntypedArrayMethods, npyffi,
};
use output::files::Cell;
use pyo3::IntoPyObjectExt;
use pyo3::buffer::PyBuffer;
use pyo3::prelude::*;
use std::ops::RangeInclusive;

/// New array of one dimension.
pub type Row<'py> = Bound<'py, PyArray1<f64>>;
/// New array of two dimensions.
pub type Rows<'py> = Bound<'py, PyArray2<f64>>;

/// Array of `f64` from a nested sequence or an array of real numbers.
fn converted<'py>(name: &str, value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let py = value.py();
    let numbers = "an array of real numbers";
    let numpy = py.import("numpy")?;
    let array = numpy
        .call_method1("asarray", (value,))
        .map_err(|error| refused(name, error.value(py), numbers))?;
    let dtype = array.getattr("dtype")?;
    let letter: String = dtype.getattr("kind")?.extract()?;
    match ["b", "i", "u", "f"].contains(&letter.as_str()) {
        true => array.call_method1("astype", ("float64",)),
        false => Err(refused(name, dtype, numbers)),
    }
}

/// Buffer of an array of `f64` in the byte order of this machine, which `PyBuffer` does not check.
fn buffer(value: &Bound<'_, PyAny>) -> Option<PyBuffer<f64>> {
    const FOREIGN: &[u8] = if cfg!(target_endian = "little") {
        b">!"
    } else {
        b"<"
    };
    let buffer = PyBuffer::<f64>::get(value).ok()?;
    let order = buffer.format().to_bytes().first();
    (!order.is_some_and(|order| FOREIGN.contains(order))).then_some(buffer)
}

/// Numbers of an array of the given shape; `None` as a length allows any. The values may be NaN or infinite.
pub fn any_numbers(
    name: &str,
    value: &Bound<'_, PyAny>,
    shape: &[Option<usize>],
) -> PyResult<Vec<f64>> {
    let py = value.py();
    // An array of f64 is copied as it is; anything else is converted first.
    let buffer = match buffer(value) {
        Some(buffer) => buffer,
        None => {
            let array = converted(name, value)?;
            if array.len().is_err() {
                // A buffer without dimensions has no shape.
                check_shape(name, &[], shape)?;
            }
            PyBuffer::get(&array)?
        }
    };
    check_shape(name, buffer.shape(), shape)?;
    buffer.to_vec(py)
}

/// Number of dimensions of an array or a nested sequence; 0 for anything else.
pub fn dimensions(value: &Bound<'_, PyAny>) -> PyResult<usize> {
    let numpy = value.py().import("numpy")?;
    let dimensions = numpy.call_method1("ndim", (value,));
    dimensions.map_or(Ok(0), |number| number.extract())
}

/// Finite numbers of an array of the given shape; `None` as a length allows any.
pub fn numbers(
    name: &str,
    value: &Bound<'_, PyAny>,
    shape: &[Option<usize>],
) -> PyResult<Vec<f64>> {
    let numbers = any_numbers(name, value, shape)?;
    match numbers.iter().position(|number| !number.is_finite()) {
        Some(place) => Err(refused(
            format!("{name}{}", indices(place, shape)),
            text(numbers[place]),
            "a finite number",
        )),
        None => Ok(numbers),
    }
}

/// Index of an entry in an array whose last length is given, as `[3]` or `[1, 3]`.
fn indices(place: usize, shape: &[Option<usize>]) -> String {
    match shape {
        [_, Some(columns)] => format!("[{}, {}]", place / columns, place % columns),
        _ => format!("[{place}]"),
    }
}

/// `N` finite numbers.
pub fn vector<const N: usize>(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[f64; N]> {
    let numbers = numbers(name, value, &[Some(N)])?;
    Ok(std::array::from_fn(|i| numbers[i]))
}

/// `N` finite numbers in single precision.
pub fn single<const N: usize>(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[f32; N]> {
    let numbers = vector::<N>(name, value)?;
    let mut singles = [0.0; N];
    for (i, (single, number)) in singles.iter_mut().zip(numbers).enumerate() {
        *single = narrow(&format!("{name}[{i}]"), number)?;
    }
    Ok(singles)
}

/// Postures, shape (n, 3): m, m, rad.
pub fn postures(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<[f32; 3]>> {
    let shape = [None, Some(3)];
    let numbers = numbers(name, value, &shape)?;
    let singles = numbers.iter().enumerate().map(|(place, number)| {
        let single = *number as f32;
        let field = || format!("{name}{}", indices(place, &shape));
        single
            .is_finite()
            .then_some(single)
            .ok_or_else(|| refused_single(field(), *number))
    });
    let singles = singles.collect::<PyResult<Vec<_>>>()?;
    Ok(singles.as_chunks().0.to_vec())
}

/// Matrix of `N` by `N` finite numbers in single precision.
pub fn matrix<const N: usize>(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[[f32; N]; N]> {
    let numbers = numbers(name, value, &[Some(N), Some(N)])?;
    let mut matrix = [[0.0; N]; N];
    for (i, (single, number)) in matrix
        .as_flattened_mut()
        .iter_mut()
        .zip(numbers)
        .enumerate()
    {
        *single = narrow(&format!("{name}[{}, {}]", i / N, i % N), number)?;
    }
    Ok(matrix)
}

/// Covariance: symmetric, with positive variances.
pub fn covariance<const N: usize>(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[[f32; N]; N]> {
    let matrix = matrix::<N>(name, value)?;
    for i in 0..N {
        let variance = matrix[i][i];
        if !(variance > 0.0) {
            let field = format!("{name}[{i}, {i}]");
            return Err(refused(field, variance, "a variance greater than 0"));
        }
        for j in 0..i {
            let (below, above) = (matrix[i][j], matrix[j][i]);
            let size = (variance * matrix[j][j]).sqrt();
            if !((below - above).abs() <= 1e-5 * size) || !(below.abs() <= size) {
                return Err(refused(
                    format!("{name}[{i}, {j}]"),
                    below,
                    format!(
                        "equal to [{j}, {i}], which is {above}, and at most {size} in magnitude"
                    ),
                ));
            }
        }
    }
    Ok(matrix)
}

/// A number as Python prints it, 1e300 rather than three hundred zeros.
pub fn text(number: f64) -> String {
    match number.is_nan() {
        true => "nan".to_owned(),
        false => format!("{number:?}"),
    }
}

/// A whole number that fits into 64 bits, such as a seed.
pub fn whole(name: &str, value: &Bound<'_, PyAny>) -> PyResult<u64> {
    whole_in(name, value, 0..=u64::MAX)
}

/// A whole number in a range.
pub fn whole_in(name: &str, value: &Bound<'_, PyAny>, range: RangeInclusive<u64>) -> PyResult<u64> {
    let number = value.call_method0("__index__");
    let number = number.and_then(|number| number.extract()).ok();
    number
        .filter(|number| range.contains(number))
        .ok_or_else(|| {
            let found = value.repr();
            let found = found.map_or_else(|_| "?".to_owned(), |it| it.to_string());
            let allowed = format!("a whole number from {} to {}", range.start(), range.end());
            refused(name, found, allowed)
        })
}

/// A finite number in single precision.
pub fn narrow(name: &str, number: f64) -> PyResult<f32> {
    let single = number as f32;
    match single.is_finite() {
        true => Ok(single),
        false => Err(refused_single(name, number)),
    }
}

fn refused_single(name: impl Into<String>, number: f64) -> PyErr {
    refused(name, text(number), "a finite number in single precision")
}

fn check_shape(name: &str, found: &[usize], wanted: &[Option<usize>]) -> PyResult<()> {
    let fits = |(found, wanted): (&usize, &Option<usize>)| wanted.is_none_or(|it| it == *found);
    match found.len() == wanted.len() && found.iter().zip(wanted).all(fits) {
        true => Ok(()),
        false => {
            let length = |it: &Option<usize>| it.map_or("any".to_owned(), |it| it.to_string());
            let wanted: Vec<_> = wanted.iter().map(length).collect();
            Err(refused(
                format!("{name}.shape"),
                format!("{found:?}"),
                format!("[{}]", wanted.join(", ")),
            ))
        }
    }
}

/// Array of `f64` that calls pass again and again. The buffer of the latest array is kept, because asking for it takes
/// longer than the copy.
#[derive(Default)]
pub struct Kept(Option<Latest>);

struct Latest {
    /// Kept alive, so no other object has its address.
    array: Py<PyArrayDyn<f64>>,
    dtype: Py<PyArrayDescr>,
    buffer: PyBuffer<f64>,
}

impl Latest {
    /// True if `object` is the kept array, and memory, shape, type and flags of the array have not changed since its
    /// buffer was taken. numpy lets the user change them while a buffer exists.
    fn is(&self, object: &Bound<'_, PyAny>) -> bool {
        if self.array.as_ptr() != object.as_ptr() {
            return false;
        }
        let array = self.array.bind(object.py());
        std::ptr::eq(array.data().cast(), self.buffer.buf_ptr())
            && array.shape() == self.buffer.shape()
            && array.strides() == self.buffer.strides()
            && array.dtype().as_ptr() == self.dtype.as_ptr()
            && (self.buffer.readonly() || is_writeable(array))
    }
}

fn is_writeable(array: &Bound<'_, PyArrayDyn<f64>>) -> bool {
    // SAFETY: the reference keeps the array alive, and only this thread uses the interpreter.
    let flags = unsafe { (*npyffi::_PyArray_GET_ITEM_DATA(array.as_array_ptr())).flags };
    flags & npyffi::NPY_ARRAY_WRITEABLE != 0
}

impl Kept {
    /// Copies an array of this length and shape into `to`; the values may be NaN or infinite.
    pub fn read(
        &mut self,
        name: &str,
        value: &Bound<'_, PyAny>,
        shape: &[usize],
        to: &mut [f64],
    ) -> PyResult<()> {
        if let Some(buffer) = self.latest(value) {
            return buffer.copy_to_slice(value.py(), to);
        }
        let shape: Vec<_> = shape.iter().copied().map(Some).collect();
        let Some(buffer) = buffer(value) else {
            to.copy_from_slice(&any_numbers(name, value, &shape)?);
            return Ok(());
        };
        check_shape(name, buffer.shape(), &shape)?;
        buffer.copy_to_slice(value.py(), to)?;
        self.0 = Self::keep(value, buffer);
        Ok(())
    }

    /// Refuses what is not a writeable array of `f64` of this shape.
    pub fn check(
        &mut self,
        name: &str,
        target: &Bound<'_, PyAny>,
        shape: &[usize],
    ) -> PyResult<()> {
        if self.latest(target).is_none() {
            self.0 = Self::keep(target, target_buffer(name, target, shape)?);
        }
        Ok(())
    }

    /// Writes the values into an array of `f64` of this shape, row by row: as many as it has entries.
    pub fn write(
        &mut self,
        name: &str,
        target: &Bound<'_, PyAny>,
        shape: &[usize],
        values: &[f64],
    ) -> PyResult<()> {
        let py = target.py();
        if let Some(buffer) = self.latest(target) {
            return buffer.copy_from_slice(py, values);
        }
        let buffer = target_buffer(name, target, shape)?;
        buffer.copy_from_slice(py, values)?;
        self.0 = Self::keep(target, buffer);
        Ok(())
    }

    fn latest(&self, object: &Bound<'_, PyAny>) -> Option<&PyBuffer<f64>> {
        let latest = self.0.as_ref().filter(|latest| latest.is(object));
        latest.map(|latest| &latest.buffer)
    }

    /// The object with its buffer; `None` for an object other than an array, which may forbid changes meanwhile.
    fn keep(object: &Bound<'_, PyAny>, buffer: PyBuffer<f64>) -> Option<Latest> {
        let array = object.cast::<PyArrayDyn<f64>>().ok()?;
        Some(Latest {
            array: array.clone().unbind(),
            dtype: array.dtype().unbind(),
            buffer,
        })
    }
}

fn target_buffer(
    name: &str,
    target: &Bound<'_, PyAny>,
    shape: &[usize],
) -> PyResult<PyBuffer<f64>> {
    let Some(buffer) = buffer(target) else {
        let dtype = target.getattr("dtype");
        let found = dtype.map_or_else(|_| target.get_type().to_string(), |it| it.to_string());
        return Err(refused(name, found, "an array of float64"));
    };
    let shape: Vec<_> = shape.iter().copied().map(Some).collect();
    check_shape(name, buffer.shape(), &shape)?;
    match buffer.readonly() {
        true => Err(refused(name, "a read-only array", "writeable")),
        false => Ok(buffer),
    }
}

/// New array of one dimension.
pub fn row<T: Element>(py: Python<'_>, values: Vec<T>) -> Bound<'_, PyArray1<T>> {
    values.into_pyarray(py)
}

/// New array of two dimensions.
pub fn rows<'py, T, const N: usize>(py: Python<'py>, rows: &[[T; N]]) -> PyResult<Rows<'py>>
where
    T: Copy + Into<f64>,
{
    let values = rows.as_flattened().iter().map(|&value| value.into());
    let flat = row(py, values.collect::<Vec<f64>>());
    flat.reshape([rows.len(), N])
}

/// Value of a cell; an empty cell is NaN.
pub fn cell(py: Python<'_>, cell: Cell) -> PyResult<Bound<'_, PyAny>> {
    match cell {
        Cell::Double(value) => value.into_bound_py_any(py),
        Cell::Single(value) => value.into_bound_py_any(py),
        Cell::Integer(value) => value.into_bound_py_any(py),
        Cell::Text(value) => value.into_bound_py_any(py),
        Cell::Empty => f64::NAN.into_bound_py_any(py),
    }
}

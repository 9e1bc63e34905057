//! Arrays and numbers from Python. Every function names the argument in its error.

use crate::errors::refused;
use numpy::{
    Element, IntoPyArray, PyArray1, PyArray2, PyArrayDyn, PyArrayMethods, PyReadwriteArrayDyn,
    PyUntypedArrayMethods,
};
use pyo3::buffer::PyBuffer;
use pyo3::prelude::*;

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
    let number = value.call_method0("__index__");
    let number = number.and_then(|number| number.extract());
    number.map_err(|_| {
        let found = value
            .repr()
            .map_or_else(|_| "?".to_owned(), |it| it.to_string());
        refused(
            name,
            found,
            format!("a whole number from 0 to {}", u64::MAX),
        )
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

/// The array itself, if its memory holds aligned `f64` of this machine. What it is may change from call to call: the user
/// may resize it or make it read-only.
fn array<'a, 'py>(value: &'a Bound<'py, PyAny>) -> Option<&'a Bound<'py, PyArrayDyn<f64>>> {
    const SIZE: usize = size_of::<f64>();
    let array = value.cast::<PyArrayDyn<f64>>().ok()?;
    let aligned = (array.data() as usize).is_multiple_of(SIZE);
    let regular = array
        .strides()
        .iter()
        .all(|it| it.unsigned_abs().is_multiple_of(SIZE));
    (aligned && regular).then_some(array)
}

/// Copies an array of this length and shape into `to`; the values may be NaN or infinite.
pub fn read(name: &str, value: &Bound<'_, PyAny>, shape: &[usize], to: &mut [f64]) -> PyResult<()> {
    let fast = array(value).filter(|array| array.shape() == shape);
    if let Some(array) = fast.and_then(|array| array.try_readonly().ok()) {
        let pairs = to.iter_mut().zip(array.as_array());
        pairs.for_each(|(to, value)| *to = *value);
        return Ok(());
    }
    let shape: Vec<_> = shape.iter().copied().map(Some).collect();
    to.copy_from_slice(&any_numbers(name, value, &shape)?);
    Ok(())
}

/// The array, if it can be written fast.
fn writeable<'py>(
    target: &Bound<'py, PyAny>,
    shape: &[usize],
) -> Option<PyReadwriteArrayDyn<'py, f64>> {
    let fast = array(target).filter(|array| array.shape() == shape);
    fast.and_then(|array| array.try_readwrite().ok())
}

/// Refuses what is not a writeable array of `f64` of this shape.
pub fn check_target(name: &str, target: &Bound<'_, PyAny>, shape: &[usize]) -> PyResult<()> {
    match writeable(target, shape) {
        Some(_) => Ok(()),
        None => target_buffer(name, target, shape).map(drop),
    }
}

/// Writes the values into a target, row by row: as many as it has entries.
pub fn write(
    name: &str,
    target: &Bound<'_, PyAny>,
    shape: &[usize],
    values: &[f64],
) -> PyResult<()> {
    match writeable(target, shape) {
        Some(mut array) => {
            let pairs = array.as_array_mut().into_iter().zip(values);
            pairs.for_each(|(to, value)| *to = *value);
            Ok(())
        }
        None => target_buffer(name, target, shape)?.copy_from_slice(target.py(), values),
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

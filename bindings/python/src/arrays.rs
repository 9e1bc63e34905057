//! Arrays and numbers from Python. Every function names the argument in its error.

use crate::errors::refused;
use numpy::{
    Element, IntoPyArray, PyArray1, PyArray2, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn,
    PyReadwriteArrayDyn, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::{PyComplex, PyDict};

/// Array of `f64` from an array or nested sequence of real numbers. An array of another kind of numbers is converted.
pub fn array<'py>(name: &str, value: &Bound<'py, PyAny>) -> PyResult<PyReadonlyArrayDyn<'py, f64>> {
    if let Ok(array) = value.cast::<PyArrayDyn<f64>>() {
        return readonly(name, array);
    }
    let py = value.py();
    let numbers = "an array of real numbers";
    let kind = || value.get_type().to_string();
    if value.is_instance_of::<PyComplex>() {
        return Err(refused(name, kind(), numbers));
    }
    let numpy = py.import("numpy")?;
    let array = numpy
        .call_method1("asarray", (value,))
        .map_err(|error| refused(name, error.value(py), numbers))?;
    let dtype = array.getattr("dtype")?;
    let letter: String = dtype.getattr("kind")?.extract()?;
    if !["b", "i", "u", "f"].contains(&letter.as_str()) {
        return Err(refused(name, dtype, numbers));
    }
    let options = PyDict::new(py);
    options.set_item("copy", false)?;
    let array = array.call_method("astype", ("float64",), Some(&options))?;
    let array = array.cast::<PyArrayDyn<f64>>().map_err(PyErr::from)?;
    readonly(name, array)
}

fn readonly<'py>(
    name: &str,
    array: &Bound<'py, PyArrayDyn<f64>>,
) -> PyResult<PyReadonlyArrayDyn<'py, f64>> {
    let taken = |_| {
        refused(
            name,
            "an array in use",
            "an array that no other call writes to",
        )
    };
    array.try_readonly().map_err(taken)
}

/// Numbers of an array of the given shape; `None` as a length allows any. The values may be NaN or infinite.
pub fn any_numbers(
    name: &str,
    value: &Bound<'_, PyAny>,
    shape: &[Option<usize>],
) -> PyResult<Vec<f64>> {
    let array = array(name, value)?;
    check_shape(name, array.shape(), shape)?;
    Ok(array.as_array().iter().copied().collect())
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
            numbers[place],
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

/// A finite number in single precision.
pub fn narrow(name: &str, number: f64) -> PyResult<f32> {
    let single = number as f32;
    match single.is_finite() {
        true => Ok(single),
        false => Err(refused(name, number, "a finite number in single precision")),
    }
}

fn check_shape(name: &str, found: &[usize], wanted: &[Option<usize>]) -> PyResult<()> {
    let fits = |(found, wanted): (&usize, &Option<usize>)| wanted.is_none_or(|it| it == *found);
    match found.len() == wanted.len() && found.iter().zip(wanted).all(fits) {
        true => Ok(()),
        false => {
            let length = |it: &Option<usize>| it.map_or("any".to_owned(), |it| it.to_string());
            let wanted: Vec<_> = wanted.iter().map(length).collect();
            Err(refused(
                format!("shape of {name}"),
                format!("{found:?}"),
                format!("[{}]", wanted.join(", ")),
            ))
        }
    }
}

/// Writes `values` into an array of `f64` of the given shape, which must be writeable.
pub fn write(
    name: &str,
    target: &Bound<'_, PyAny>,
    shape: &[usize],
    values: impl IntoIterator<Item = f64>,
) -> PyResult<()> {
    let mut array = writeable(name, target, shape)?;
    for (entry, value) in array.as_array_mut().iter_mut().zip(values) {
        *entry = value;
    }
    Ok(())
}

/// Refuses what [`write`] refuses.
pub fn check_target(name: &str, target: &Bound<'_, PyAny>, shape: &[usize]) -> PyResult<()> {
    writeable(name, target, shape).map(drop)
}

fn writeable<'py>(
    name: &str,
    target: &Bound<'py, PyAny>,
    shape: &[usize],
) -> PyResult<PyReadwriteArrayDyn<'py, f64>> {
    let Ok(array) = target.cast::<PyArrayDyn<f64>>() else {
        let dtype = target.getattr("dtype");
        let found = dtype.map_or_else(|_| target.get_type().to_string(), |it| it.to_string());
        return Err(refused(name, found, "a numpy array of float64"));
    };
    let wanted: Vec<_> = shape.iter().copied().map(Some).collect();
    check_shape(name, array.shape(), &wanted)?;
    let read_only = |_| refused(name, "read-only or in use", "a writeable array");
    array.try_readwrite().map_err(read_only)
}

/// New array of one dimension.
pub fn row<T: Element>(py: Python<'_>, values: Vec<T>) -> Bound<'_, PyArray1<T>> {
    values.into_pyarray(py)
}

/// New array of two dimensions.
pub fn rows<'py, T, const N: usize>(
    py: Python<'py>,
    rows: &[[T; N]],
) -> PyResult<Bound<'py, PyArray2<f64>>>
where
    T: Copy + Into<f64>,
{
    let values = rows.as_flattened().iter().map(|&value| value.into());
    let flat = row(py, values.collect::<Vec<f64>>());
    flat.reshape([rows.len(), N])
}

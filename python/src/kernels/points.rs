//! Points: voxels, curves, neighbors.

use crate::arrays::{Input, column, indices, optional, shaped, table};
use crate::errors::{argument, error};
use crate::work::compute;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use scenesplat::kernels::grid_sample::{KeyOrder, voxel_groups};
use scenesplat::kernels::neighbors::{KdTree, Neighbor};
use scenesplat::kernels::serialization::{Curve, MAX_DEPTH, argsort, codes, depth_of, invert};
use scenesplat::metrics::vote;

/// Rows of points grouped by voxel.
#[pyfunction]
pub fn grid_sample<'py>(
    py: Python<'py>,
    coord: &Bound<'py, PyAny>,
    grid_size: f64,
    order: &str,
) -> PyResult<Bound<'py, PyDict>> {
    let key_order = match order {
        "morton" => KeyOrder::Morton,
        "fnv" => KeyOrder::Fnv,
        "ravel" => KeyOrder::Ravel,
        _ => {
            let problem = format!("{order:?} is none of \"morton\", \"fnv\", \"ravel\"");
            return Err(argument("order", problem));
        }
    };
    let coord = Input::<f32>::new("coord", coord)?;
    let coord = coord.rows::<3>()?;
    let found = compute(py, || voxel_groups(coord, grid_size, key_order))?.map_err(error)?;
    let all = PyDict::new(py);
    all.set_item("order", indices(py, &found.order))?;
    all.set_item("offsets", indices(py, &found.offsets))?;
    all.set_item("inverse", indices(py, &found.inverse))?;
    all.set_item("grid_coord", table(py, found.grid_coord.as_flattened().to_vec(), 3)?)?;
    all.set_item("min_cell", column(py, found.min_cell.to_vec()))?;
    Ok(all)
}

/// Codes, orders and inverse orders along curves, a row for each.
#[pyfunction]
pub fn serialize<'py>(
    py: Python<'py>,
    grid_coord: &Bound<'py, PyAny>,
    curves: Vec<String>,
    depth: Option<u32>,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let curve_of = |name: &String| {
        let known = || Curve::ALL.map(Curve::name).join(", ");
        Curve::from_name(name)
            .ok_or_else(|| argument("curves", format!("{name:?} is none of {}", known())))
    };
    let curves: Vec<Curve> = curves.iter().map(curve_of).collect::<PyResult<_>>()?;
    let cells = Input::<i32>::new("grid_coord", grid_coord)?;
    let cells = cells.rows::<3>()?;
    let needed = compute(py, || depth_of(cells))?.map_err(error)?;
    let depth = depth.unwrap_or(needed);
    if !(needed..=MAX_DEPTH).contains(&depth) {
        let problem = format!("{depth} bits; these cells need {needed}, and there are {MAX_DEPTH}");
        return Err(argument("depth", problem));
    }
    let (all, orders, inverses) = compute(py, || {
        let (mut all, mut orders, mut inverses) = (Vec::new(), Vec::new(), Vec::new());
        for &curve in &curves {
            let codes = codes(curve, cells, depth);
            let order = argsort(&codes);
            inverses.extend(invert(&order).into_iter().map(i64::from));
            orders.extend(order.into_iter().map(i64::from));
            // At most 63 bits.
            all.extend(codes.into_iter().map(|code| code as i64));
        }
        (all, orders, inverses)
    })?;
    let sides = [curves.len(), cells.len()];
    Ok((shaped(py, all, &sides)?, shaped(py, orders, &sides)?, shaped(py, inverses, &sides)?))
}

/// Rows and distances of the nearest points of each query.
#[pyfunction]
pub fn knn<'py>(
    py: Python<'py>,
    points: &Bound<'py, PyAny>,
    query: Option<&Bound<'py, PyAny>>,
    k: usize,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let points = Input::<f32>::new("points", points)?;
    let points = points.rows::<3>()?;
    let own = optional::<f32>("query", query)?;
    let query = own.as_ref().map_or(Ok(points), |query| query.rows::<3>())?;
    if !(1..=points.len()).contains(&k) {
        return Err(argument("k", format!("{k} is not in 1 to {}, the points", points.len())));
    }
    if u32::try_from(query.len()).is_err() {
        return Err(argument("query", format!("{} rows are too many; split them", query.len())));
    }
    if let Some(row) = query.iter().position(|q| !q.iter().all(|v| v.is_finite())) {
        return Err(argument("query", format!("row {row} is {:?}, not finite", query[row])));
    }
    let found = compute(py, || {
        let tree = KdTree::new(points)?;
        Ok(tree.map_nearest(query, k, || (), |(), _, near: &[Neighbor]| near.to_vec()))
    })?;
    let found: Vec<Vec<Neighbor>> =
        found.map_err(|e: scenesplat::kernels::neighbors::NeighborError| error(e))?;
    let rows = found.iter().flatten().map(|n| i64::from(n.row)).collect();
    let far = found.iter().flatten().map(|n| n.distance_squared.sqrt()).collect::<Vec<f64>>();
    Ok((table(py, rows, k)?.into_any(), table(py, far, k)?.into_any()))
}

/// The label that most of the nearest points have, for each query.
#[pyfunction]
pub fn knn_vote<'py>(
    py: Python<'py>,
    coord: &Bound<'py, PyAny>,
    labels: &Bound<'py, PyAny>,
    query: Option<&Bound<'py, PyAny>>,
    k: usize,
    num_classes: Option<usize>,
    valid: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let coord = Input::<f32>::new("coord", coord)?;
    let coord = coord.rows::<3>()?;
    let labels = Input::<i32>::new("labels", labels)?;
    let labels = labels.column(Some(coord.len()))?;
    let valid = optional::<bool>("valid", valid)?;
    let valid = valid.as_ref().map(|valid| valid.column(Some(coord.len()))).transpose()?;
    let own = optional::<f32>("query", query)?;
    let query = own.as_ref().map_or(Ok(coord), |query| query.rows::<3>())?;
    let highest = labels.iter().copied().max().and_then(|label| usize::try_from(label).ok());
    let classes = num_classes.unwrap_or(highest.map_or(1, |highest| highest + 1));
    let found = compute(py, || vote(coord, labels, valid, query, k, classes))?.map_err(error)?;
    Ok(column(py, found).into_any())
}

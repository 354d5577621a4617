use super::super::operations::{Operation, Tensor};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The operation of a node with these attributes.
fn operation(op: &str, attributes: &Value) -> Operation {
    let map: BTreeMap<String, Value> =
        attributes.as_object().unwrap_or(&Map::new()).clone().into_iter().collect();
    Operation::of(op, &super::super::attributes::Attributes(&map)).unwrap()
}

fn run(op: &Operation, inputs: Vec<Tensor>) -> Result<Tensor, String> {
    op.run(inputs.into_iter().map(Arc::new).collect())
        .map(|mut results| (*results.remove(0)).clone())
}

fn floats(shape: &[usize], values: impl IntoIterator<Item = f32>) -> Tensor {
    Tensor::floats(shape.to_vec(), values.into_iter().collect())
}

fn counted(shape: &[usize]) -> Tensor {
    floats(shape, (0..shape.iter().product::<usize>()).map(|i| i as f32))
}

fn ints(values: &[i64]) -> Tensor {
    Tensor::ints(vec![values.len()], values.to_vec())
}

fn check(found: Result<Tensor, String>, shape: &[usize], values: &[f32]) {
    let found = found.unwrap();
    assert_eq!((&*found.shape, found.as_floats().unwrap()), (shape, values));
}

#[test]
fn sums_repeat_axes_of_one() {
    let add = operation("Add", &json!({}));
    check(
        run(&add, vec![counted(&[2, 2]), floats(&[2], [10.0, 20.0])]),
        &[2, 2],
        &[10.0, 21.0, 12.0, 23.0],
    );
    check(
        run(&add, vec![floats(&[2, 1], [10.0, 20.0]), counted(&[2, 2])]),
        &[2, 2],
        &[10.0, 11.0, 22.0, 23.0],
    );
    // Both are repeated.
    check(
        run(&add, vec![floats(&[2, 1], [1.0, 2.0]), floats(&[1, 3], [10.0, 20.0, 30.0])]),
        &[2, 3],
        &[11.0, 21.0, 31.0, 12.0, 22.0, 32.0],
    );
    let channel = run(&add, vec![counted(&[1, 2, 1, 2]), floats(&[1, 2, 1, 1], [0.5, 0.25])]);
    check(channel, &[1, 2, 1, 2], &[0.5, 1.5, 2.25, 3.25]);
    let sizes = run(&add, vec![ints(&[1, -1]), ints(&[2, 3])]).unwrap();
    assert_eq!(sizes, ints(&[3, 2]));
    for bad in [
        vec![counted(&[2]), counted(&[3])],
        vec![counted(&[2]), ints(&[1, 2])],
        vec![counted(&[2])],
    ] {
        assert!(run(&add, bad).is_err());
    }
}

#[test]
fn values_are_bent_by_their_formulas() {
    let leaky = operation("LeakyRelu", &json!({"alpha": {"f": 0.1}}));
    check(run(&leaky, vec![floats(&[3], [-2.0, 0.0, 3.0])]), &[3], &[-0.2, 0.0, 3.0]);
    check(run(&operation("LeakyRelu", &json!({})), vec![floats(&[1], [-2.0])]), &[1], &[-0.4]);
    let found =
        run(&operation("Sigmoid", &json!({})), vec![floats(&[3], [0.0, 4.0, -200.0])]).unwrap();
    let [half, most, none] = found.as_floats().unwrap() else { panic!() };
    assert!(*half == 0.5 && (most - 0.982_013_8).abs() < 1e-6 && (0.0..1e-30).contains(none));
    // A value that two layers read is not written over.
    let shared = Arc::new(floats(&[1], [-1.0]));
    leaky.run(vec![Arc::clone(&shared)]).unwrap();
    assert_eq!(shared.as_floats().unwrap(), [-1.0]);
}

#[test]
fn axes_are_exchanged_as_by_the_definition() {
    let transpose = operation("Transpose", &json!({}));
    // Wider than a tile of 32 on both sides.
    for (shape, axes) in [
        (vec![1, 5, 40, 3], vec![0, 3, 1, 2]),
        (vec![1, 37, 5, 41], vec![0, 2, 3, 1]),
        (vec![4, 1, 6], vec![2, 1, 0]),
        (vec![2, 3], vec![0, 1]),
        (vec![3, 1, 2, 1], vec![1, 3, 2, 0]),
    ] {
        let x = counted(&shape);
        let order = ints(&axes.iter().map(|a| *a as i64).collect::<Vec<_>>());
        let found = run(&transpose, vec![x.clone(), order]).unwrap();
        let to: Vec<usize> = axes.iter().map(|a: &usize| shape[*a]).collect();
        assert_eq!(found.shape, to);
        for (at, value) in found.as_floats().unwrap().iter().enumerate() {
            let (mut rest, mut place) = (at, vec![0; shape.len()]);
            for axis in (0..to.len()).rev() {
                place[axes[axis]] = rest % to[axis];
                rest /= to[axis];
            }
            let from = place.iter().zip(&shape).fold(0, |sum, (p, side)| sum * side + p);
            assert_eq!(*value, x.as_floats().unwrap()[from], "{shape:?} {axes:?} {at}");
        }
    }
    for bad in [&[0, 0][..], &[0], &[1, 2]] {
        assert!(run(&transpose, vec![counted(&[2, 3]), ints(bad)]).is_err());
    }
    let three = run(&transpose, vec![counted(&[2, 3, 4]), ints(&[2, 1, 0])]).unwrap_err();
    assert!(three.contains("more than two parts"), "{three}");
}

#[test]
fn shapes_are_changed_joined_split_and_padded() {
    let reshape = operation("Reshape", &json!({}));
    assert_eq!(run(&reshape, vec![counted(&[2, 6]), ints(&[3, -1])]).unwrap().shape, [3, 4]);
    for bad in [&[5, -1][..], &[-1, -1], &[-2, 6], &[11]] {
        assert!(run(&reshape, vec![counted(&[2, 6]), ints(bad)]).is_err(), "{bad:?}");
    }
    let concat = operation("ConcatV2", &json!({}));
    let parts = vec![counted(&[2, 1]), floats(&[2, 2], [5.0, 6.0, 7.0, 8.0]), ints(&[1])];
    check(run(&concat, parts), &[2, 3], &[0.0, 5.0, 6.0, 1.0, 7.0, 8.0]);
    check(
        run(&concat, vec![counted(&[1, 2]), counted(&[1, 2]), ints(&[-2])]),
        &[2, 2],
        &[0.0, 1.0, 0.0, 1.0],
    );
    assert_eq!(
        run(&concat, vec![ints(&[1, 2]), ints(&[3]), ints(&[0])]).unwrap(),
        ints(&[1, 2, 3])
    );
    assert!(run(&concat, vec![counted(&[2, 1]), counted(&[3, 1]), ints(&[1])]).is_err());
    assert!(run(&concat, vec![counted(&[2, 1]), counted(&[2, 1]), ints(&[2])]).is_err());

    let split = operation("SplitV", &json!({"num_split": {"i": "2"}}));
    let [x, sizes, axis] = [counted(&[2, 3, 2]), ints(&[1, 2]), ints(&[1])].map(Arc::new);
    let found = split.run(vec![Arc::clone(&x), sizes, axis]).unwrap();
    assert_eq!(*found[0], floats(&[2, 1, 2], [0.0, 1.0, 6.0, 7.0]));
    assert_eq!(*found[1], floats(&[2, 2, 2], [2.0, 3.0, 4.0, 5.0, 8.0, 9.0, 10.0, 11.0]));
    assert!(
        split
            .run([ints(&[3]), ints(&[1])].map(Arc::new).into_iter().fold(vec![x], |mut v, t| {
                v.push(t);
                v
            }))
            .is_err()
    );

    let pad = operation("Pad", &json!({}));
    let widths = Tensor::ints(vec![4, 2], vec![0, 0, 1, 0, 0, 2, 0, 0]);
    let padded = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0];
    check(run(&pad, vec![counted(&[1, 1, 2, 1]), widths.clone()]), &[1, 2, 4, 1], &padded);
    let value = floats(&[], [-9.0]);
    let around = [-9.0, -9.0, -9.0, -9.0, 0.0, 1.0, -9.0, -9.0];
    check(
        run(&operation("PadV2", &json!({})), vec![counted(&[1, 1, 2, 1]), widths, value]),
        &[1, 2, 4, 1],
        &around,
    );
    assert!(run(&pad, vec![counted(&[2]), ints(&[1])]).is_err());

    let dense = operation("SparseToDense", &json!({}));
    let none = || Tensor::ints(vec![0, 1], Vec::new());
    assert_eq!(
        run(&dense, vec![none(), ints(&[2]), ints(&[]), ints(&[7])]).unwrap(),
        ints(&[7, 7])
    );
    assert!(run(&dense, vec![ints(&[0]), ints(&[2]), ints(&[1]), ints(&[7])]).is_err());
}

#[test]
fn pictures_are_enlarged_between_the_middles_of_pixels() {
    let attributes = json!({"half_pixel_centers": {"b": true}, "align_corners": {"b": false}});
    let resize = operation("ResizeBilinear", &attributes);
    // Two columns to four: middles at −0.25 (0), 0.25, 0.75, 1.25 (1). One row to two: the same twice.
    let found = run(&resize, vec![floats(&[1, 1, 2, 2], [0.0, 8.0, 4.0, 0.0]), ints(&[2, 4])]);
    let row = [0.0, 8.0, 1.0, 6.0, 3.0, 2.0, 4.0, 0.0];
    check(found, &[1, 2, 4, 2], &[row, row].concat());
    // Three rows to two: middles at 0.25 and 1.75.
    let found = run(&resize, vec![floats(&[1, 3, 1, 1], [0.0, 4.0, 20.0]), ints(&[2, 1])]);
    check(found, &[1, 2, 1, 1], &[1.0, 16.0]);
    assert!(run(&resize, vec![counted(&[1, 1, 1, 1]), ints(&[0, 4])]).is_err());
    assert!(run(&resize, vec![counted(&[1, 1, 1]), ints(&[2, 4])]).is_err());
}

/// Height, width, channels in and out, window, strides, whether padded.
type Case = ([usize; 2], usize, usize, [usize; 2], [usize; 2], bool);

#[test]
fn windows_are_products_and_maxima_over_their_pixels() {
    let cases: [Case; 6] = [
        ([5, 7], 3, 4, [3, 2], [1, 1], false),
        ([5, 7], 3, 4, [3, 2], [2, 3], false),
        ([6, 5], 2, 3, [3, 3], [1, 1], true),
        ([6, 5], 2, 3, [3, 4], [2, 1], true),
        ([4, 3], 5, 2, [1, 1], [1, 1], false),
        ([4, 5], 2, 2, [1, 1], [2, 2], true),
    ];
    for (number, ([height, width], channels, out, [tall, wide], [down, across], same)) in
        cases.into_iter().enumerate()
    {
        let noise = |at: usize| ((at * 7919 + number * 131) % 257) as f32 / 64.0 - 2.0;
        let x = floats(&[1, height, width, channels], (0..height * width * channels).map(noise));
        let weights = floats(
            &[tall, wide, channels, out],
            (0..tall * wide * channels * out).map(|i| noise(i + 5)),
        );
        let attributes = json!({
            "padding": {"s": if same { "U0FNRQ==" } else { "VkFMSUQ=" }},
            "strides": {"list": {"i": ["1", down.to_string(), across.to_string(), "1"]}},
            "ksize": {"list": {"i": [1, tall, wide, 1]}},
        });
        // As TensorFlow says it: the odd pixel of padding is behind.
        let sides = |length: usize, window: usize, stride: usize| {
            if !same {
                return ((length - window) / stride + 1, 0);
            }
            let count = length.div_ceil(stride);
            (count, ((count - 1) * stride + window).saturating_sub(length) / 2)
        };
        let (rows, above) = sides(height, tall, down);
        let (columns, left) = sides(width, wide, across);
        let at = |y: isize, x_: isize, c: usize| {
            let inside = (0..height as isize).contains(&y) && (0..width as isize).contains(&x_);
            inside
                .then(|| x.as_floats().unwrap()[(y as usize * width + x_ as usize) * channels + c])
        };
        let (mut sums, mut maxima) = (Vec::new(), Vec::new());
        for row in 0..rows {
            for column in 0..columns {
                let place = |dy: usize, dx: usize| {
                    (
                        (row * down + dy) as isize - above as isize,
                        (column * across + dx) as isize - left as isize,
                    )
                };
                let window = || (0..tall).flat_map(|dy| (0..wide).map(move |dx| (dy, dx)));
                for k in 0..out {
                    let term = |(dy, dx): (usize, usize), c: usize| {
                        let (y, x) = place(dy, dx);
                        let w = weights.as_floats().unwrap()
                            [((dy * wide + dx) * channels + c) * out + k];
                        f64::from(at(y, x, c).unwrap_or(0.0)) * f64::from(w)
                    };
                    sums.push(
                        window()
                            .map(|d| (0..channels).map(|c| term(d, c)).sum::<f64>())
                            .sum::<f64>(),
                    );
                }
                for c in 0..channels {
                    let values =
                        window().filter_map(|(dy, dx)| at(place(dy, dx).0, place(dy, dx).1, c));
                    maxima.push(values.fold(f32::NEG_INFINITY, f32::max));
                }
            }
        }
        let product = operation("Conv2D", &attributes);
        assert!(run(&product, vec![x.clone()]).unwrap_err().contains("no constant"));
        let packed = product.packed(&weights).unwrap().unwrap();
        let found = run(&packed, vec![x.clone()]).unwrap();
        assert_eq!(found.shape, [1, rows, columns, out]);
        let off =
            found.as_floats().unwrap().iter().zip(&sums).map(|(a, b)| (f64::from(*a) - b).abs());
        assert!(off.fold(0.0, f64::max) < 1e-4, "case {number}");
        check(
            run(&operation("MaxPool", &attributes), vec![x.clone()]),
            &[1, rows, columns, channels],
            &maxima,
        );
        assert!(
            run(&packed, vec![counted(&[1, 8, 8, channels + 1])]).unwrap_err().contains("channels")
        );
    }
    let wide = json!({"padding": {"s": "VkFMSUQ="}, "ksize": {"list": {"i": [1, 3, 3, 1]}}});
    let error = run(&operation("MaxPool", &wide), vec![counted(&[1, 2, 5, 1])]).unwrap_err();
    assert!(error.contains("a window of 3 is wider than 2"), "{error}");
}

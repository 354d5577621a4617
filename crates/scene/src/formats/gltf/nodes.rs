//! Which meshes a document shows, and where.

use super::document::{Document, Node};
use super::file_error;
use crate::SceneError;
use crate::frame::{Matrix3, matrix, product};
use crate::vector::rotation;
use glam::DVec3;
use std::path::Path;

/// `p ↦ linear · p + translation`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::formats) struct Affine {
    pub linear: Matrix3,
    pub translation: [f64; 3],
}

impl Affine {
    pub(in crate::formats) const IDENTITY: Self =
        Self { linear: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], translation: [0.0; 3] };

    /// First `other`, then this.
    pub(in crate::formats) fn after(&self, other: &Self) -> Self {
        Self {
            linear: product(&self.linear, &other.linear),
            translation: self.apply(other.translation),
        }
    }

    pub(in crate::formats) fn apply(&self, p: [f64; 3]) -> [f64; 3] {
        (matrix(&self.linear) * DVec3::from(p) + DVec3::from(self.translation)).to_array()
    }
}

impl Default for Affine {
    fn default() -> Self {
        Self::IDENTITY
    }
}

/// A mesh and how it is placed in the world.
pub(super) struct Placed {
    pub node: usize,
    pub mesh: usize,
    pub world: Affine,
}

/// The meshes of the document's scene in the order of its nodes, children after their parents.
pub(super) fn placed_meshes(
    document: &Document<'_>,
    path: &Path,
) -> Result<Vec<Placed>, SceneError> {
    let nodes = &document.nodes;
    let mut stack: Vec<(usize, Affine)> = Vec::new();
    // Children are put on the stack in reverse, so that the first is met first.
    let roots = roots(document, path)?;
    stack.extend(roots.into_iter().rev().map(|root| (root, Affine::IDENTITY)));
    let mut met = vec![false; nodes.len()];
    let mut placed = Vec::new();
    while let Some((i, parent)) = stack.pop() {
        let Some(node) = nodes.get(i) else {
            return Err(file_error(
                path,
                format!("node {i} is missing: there are {}", nodes.len()),
            ));
        };
        // Also what keeps a document from being endless.
        if std::mem::replace(&mut met[i], true) {
            return Err(file_error(path, format!("node {i} is in the scene more than once")));
        }
        let world = parent.after(&local(node, i, path)?);
        if let Some(mesh) = node.mesh {
            placed.push(Placed { node: i, mesh: mesh as usize, world });
        }
        stack.extend(node.children.iter().rev().map(|&child| (child as usize, world)));
    }
    Ok(placed)
}

/// The nodes to begin with: those of the default scene, else of the first, else all that are no
/// node's child.
fn roots(document: &Document<'_>, path: &Path) -> Result<Vec<usize>, SceneError> {
    let scenes = &document.scenes;
    if let Some(scene) = scenes.get(document.scene.unwrap_or(0)) {
        return Ok(scene.nodes.iter().map(|&node| node as usize).collect());
    }
    if let Some(scene) = document.scene {
        let problem = format!("scene {scene} is missing: there are {}", scenes.len());
        return Err(file_error(path, problem));
    }
    let mut is_child = vec![false; document.nodes.len()];
    for &child in document.nodes.iter().flat_map(|node| &node.children) {
        if let Some(flag) = is_child.get_mut(child as usize) {
            *flag = true;
        }
    }
    Ok((0..is_child.len()).filter(|&node| !is_child[node]).collect())
}

/// A node's own transformation.
fn local(node: &Node, i: usize, path: &Path) -> Result<Affine, SceneError> {
    if let Some(m) = &node.matrix {
        let linear = [0, 1, 2].map(|row| [m[row], m[4 + row], m[8 + row]]);
        if [m[3], m[7], m[11], m[15]] != [0.0, 0.0, 0.0, 1.0] {
            let problem = format!("node {i} has a matrix whose last row is not 0, 0, 0, 1");
            return Err(file_error(path, problem));
        }
        return Ok(Affine { linear, translation: [m[12], m[13], m[14]] });
    }
    let mut linear = Affine::IDENTITY.linear;
    if let Some(q) = &node.rotation {
        let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        if !(norm.is_finite() && norm > 1e-6) {
            return Err(file_error(path, format!("node {i} has the rotation {q:?}")));
        }
        let [x, y, z, w] = q.map(|v| v / norm);
        linear = rotation([w, x, y, z]);
    }
    if let Some(scale) = &node.scale {
        linear = linear.map(|row| [row[0] * scale[0], row[1] * scale[1], row[2] * scale[2]]);
    }
    Ok(Affine { linear, translation: node.translation.as_deref().copied().unwrap_or_default() })
}

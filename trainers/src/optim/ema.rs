use super::slices::{self, InPlace};
use crate::TrainError;
use crate::error::check_setting;
use candle_core::{Result as TensorResult, Var};
use std::collections::BTreeMap;

/// Moves each teacher parameter toward the student's: `t ← m·t + (1 − m)·s`.
///
/// Every parameter of `teacher` must be in `student`, of the same shape and type; the student may
/// have more. What is averaged is the caller's choice: the original averages parameters only and
/// lets the teacher's batch statistics develop on their own.
///
/// # Errors
/// If `momentum` is outside `0..=1`, or a parameter is missing or differs in shape or type. Nothing
/// has changed then.
///
/// # Source
/// `update_teacher` of the self-supervised trainer, SceneSplat be9d5e1.
pub fn ema_update(
    teacher: &BTreeMap<String, Var>,
    student: &BTreeMap<String, Var>,
    momentum: f64,
) -> Result<(), TrainError> {
    check_setting("momentum", momentum, (0.0..=1.0).contains(&momentum), "in 0..=1")?;
    let mut pairs = Vec::with_capacity(teacher.len());
    for (name, t) in teacher {
        let s = student
            .get(name)
            .ok_or_else(|| TrainError::MissingParameter { what: "student", name: name.clone() })?;
        super::adamw::check_like("student", name, s, t)?;
        pairs.push((name, t, s));
    }
    for (name, t, s) in pairs {
        // A teacher that still shares its student's memory is already what it would become.
        if t.id() != s.id() {
            update(t, s, momentum).map_err(TrainError::tensor(name))?;
        }
    }
    Ok(())
}

fn update(teacher: &Var, student: &Var, momentum: f64) -> TensorResult<()> {
    if slices::is_slice(teacher) && slices::is_slice(student) {
        let (keep, take) = (momentum as f32, 1.0 - momentum as f32);
        return teacher.inplace_op2(student, &InPlace("ema", |t, s| t * keep + s * take));
    }
    let (t, s) = (teacher.as_detached_tensor(), student.as_detached_tensor());
    teacher.set(&(t.affine(momentum, 0.0)? + s.affine(1.0 - momentum, 0.0)?)?)
}

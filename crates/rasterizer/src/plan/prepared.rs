//! A scene made ready for a plan, and its pictures.

use super::{PlanError, RenderPlan};
use crate::profile::FAINT;
use crate::{Gaussians, RenderRequest, Rendered, View, render};

/// A scene with the plan that renders it.
#[derive(Debug, Clone)]
pub struct Prepared {
    plan: RenderPlan,
    gaussians: Gaussians,
    rows: Option<Vec<u32>>,
}

impl RenderPlan {
    /// Makes a scene ready: takes out the Gaussians that are never drawn, if that was decided.
    ///
    /// # Errors
    /// If the scene is not the one that was profiled.
    pub fn prepare(&self, mut gaussians: Gaussians) -> Result<Prepared, PlanError> {
        gaussians.check()?;
        let (planned, got) = (self.profile.gaussians, gaussians.len());
        if planned != got || self.profile.harmonics.degree != gaussians.sh_degree {
            return Err(PlanError::OtherScene { planned, got });
        }
        let rows = self.drop_faint.then(|| drop_faint(&mut gaussians));
        Ok(Prepared { plan: self.clone(), gaussians, rows })
    }
}

impl Prepared {
    /// Renders a view as planned.
    ///
    /// # Errors
    /// If the request asks for more than the plan has ([`RenderPlan::check`]), and what
    /// [`render`](fn@crate::render::render) refuses.
    pub fn render(&self, view: &View, request: &RenderRequest) -> Result<Rendered, PlanError> {
        self.plan.check(request)?;
        let wanted = request.sh_degree.unwrap_or(3);
        let mut request =
            RenderRequest { sh_degree: Some(wanted.min(self.plan.sh_degree)), ..*request };
        if self.plan.is_full {
            request.depth = self.plan.effective().depth;
        }
        Ok(render(&self.gaussians, view, &self.plan.settings, &request)?)
    }

    /// The plan.
    pub fn plan(&self) -> &RenderPlan {
        &self.plan
    }

    /// The Gaussians that are left.
    pub fn gaussians(&self) -> &Gaussians {
        &self.gaussians
    }

    /// Which rows of the scene are left; `None` = all.
    pub fn rows(&self) -> Option<&[u32]> {
        self.rows.as_deref()
    }
}

/// Keeps the rows that can be drawn, in place and in order.
fn drop_faint(gaussians: &mut Gaussians) -> Vec<u32> {
    let rows: Vec<u32> =
        (0..).zip(&gaussians.opacities).filter(|(_, o)| **o >= FAINT).map(|(i, _)| i).collect();
    fn compact<T: Copy>(values: &mut Vec<T>, width: usize, rows: &[u32]) {
        for (to, &row) in rows.iter().enumerate() {
            let from = row as usize * width;
            values.copy_within(from..from + width, to * width);
        }
        values.truncate(rows.len() * width);
    }
    let width = 3 * gaussians.sh_len();
    compact(&mut gaussians.means, 1, &rows);
    compact(&mut gaussians.quats, 1, &rows);
    compact(&mut gaussians.scales, 1, &rows);
    compact(&mut gaussians.opacities, 1, &rows);
    compact(&mut gaussians.sh, width, &rows);
    rows
}

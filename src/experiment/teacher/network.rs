//! A network as a teacher.

use super::cache::{Cache, Key};
use super::record::TeacherRecord;
use crate::network::Network;
use candle_core::{Device, Tensor};
use half::f16;
use half::slice::HalfFloatSliceExt;
use rand_chacha::ChaCha8Rng;
use rayon::{ThreadPool, ThreadPoolBuilder};
use scenesplat_datasets::transforms::CenterShift;
use scenesplat_datasets::{
    DataError, Sample, SceneTeacher, TeacherRows, TeacherView, Transform, sample_rng,
};
use scenesplat_kernels::grid_sample::{KeyOrder, voxel_groups};
use scenesplat_models::ops::normalize_rows;
use scenesplat_models::{Forward, PointCloud};
use scenesplat_scene::LanguageFeatures;
use std::sync::{Arc, Mutex, PoisonError};

/// A network that reads one scene at a time with all cores, whoever asks: several at once would need as
/// much more memory.
pub(super) struct Reader {
    network: Network,
    /// Everything that its rows depend on, besides the scene.
    identity: String,
    /// How many threads read a scene.
    threads: usize,
    /// They, once a scene was read.
    workers: Mutex<Option<ThreadPool>>,
}

/// A network that says what the rows of another shall be; frozen, in evaluation mode.
pub(super) struct NetworkTeacher {
    pub reader: Arc<Reader>,
    pub view: TeacherView,
    pub cache: Option<Arc<Cache>>,
    pub record: Arc<TeacherRecord>,
}

impl SceneTeacher for NetworkTeacher {
    fn view(&self) -> TeacherView {
        self.view
    }

    fn teach(&self, mut shown: Sample) -> Result<TeacherRows, DataError> {
        shown.lang_feat = None;
        if self.view == TeacherView::Scene {
            // Where the network's own evaluation puts a scene.
            CenterShift::default().apply(&mut shown, &mut sample_rng(0, 0, 0))?;
        }
        let Some(cache) = &self.cache else {
            self.record.with(|counts| counts.taught += 1);
            return self.reader.rows(shown);
        };
        let key = Key::new(&self.reader.identity, &shown);
        let (id, gaussians) = (shown.id.clone(), shown.len());
        let width = self.reader.network.model().out_channels();
        if let Some(rows) = cache.read(key, (&id, gaussians), width)? {
            return Ok(rows);
        }
        self.record.with(|counts| counts.taught += 1);
        let rows = self.reader.rows(shown)?;
        cache.write(key, &rows);
        Ok(rows)
    }
}

impl Reader {
    /// With as many threads as work for the thread that calls.
    pub(super) fn new(network: Network, identity: String) -> Self {
        let threads = rayon::current_num_threads();
        Self { network, identity, threads, workers: Mutex::new(None) }
    }

    /// Unit rows, one for each voxel of the network's own size.
    fn rows(&self, shown: Sample) -> Result<TeacherRows, DataError> {
        let mut workers = self.workers.lock().unwrap_or_else(PoisonError::into_inner);
        // A thread that makes batches has a pool of itself alone, and would read the scene on one core. The pool that all
        // share is no way out: the thread that trains may be all of it, and waits for this batch.
        let workers = match &mut *workers {
            Some(workers) => workers,
            none => {
                let pool = ThreadPoolBuilder::new().num_threads(self.threads).build();
                none.insert(pool.map_err(DataError::teacher)?)
            }
        };
        workers.install(|| self.compute(shown))
    }

    fn compute(&self, mut shown: Sample) -> Result<TeacherRows, DataError> {
        let groups = voxel_groups(&shown.coord, self.network.grid_size(), KeyOrder::Morton)?;
        // As in inference, the Gaussian nearest to its center stands for a voxel.
        shown.select_rows(&groups.nearest_to_centre(&shown.coord)?);
        let input = self.network.input();
        let feat = input.sample_rows(&shown)?;
        let row_of = groups.inverse;
        let model = self.network.model();
        let forward = || {
            let feat = Tensor::from_vec(feat, (shown.len(), input.width()), &Device::Cpu)?;
            let points = PointCloud::single(groups.grid_coord, feat)?;
            let mut rng: ChaCha8Rng = sample_rng(0, 0, 0);
            model.forward(&points, &mut Forward::eval(&mut rng))?.flatten_all()?.to_vec1::<f32>()
        };
        let mut rows = forward().map_err(DataError::teacher)?;
        let dim = model.out_channels();
        if let Some(at) = rows.iter().position(|v| !v.is_finite()) {
            let (row, column) = (at / dim, at % dim);
            let problem = format!("channel {column} of its voxel {row} is {}", rows[at]);
            return Err(DataError::teacher(problem));
        }
        normalize_rows(&mut rows, dim);
        let mut values = vec![f16::ZERO; rows.len()];
        values.convert_from_f32_slice(&rows);
        Ok(TeacherRows { rows: LanguageFeatures { values, dim }, row_of })
    }
}

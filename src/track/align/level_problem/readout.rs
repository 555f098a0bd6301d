//! What a frame says of the time in which the sensor's rows are read.

use super::super::Sensor;
use super::super::system::schur_complement::{Clue, SchurComplement, SolvedTile};
use super::super::tile_equations::TileStep;
use super::{Corrected, LevelProblem, LevelSpec};

impl LevelProblem {
    /// The clue on the readout, seconds; `None` where nothing was solved. After [`LevelProblem::conclude`].
    pub fn readout_clue(&self, spec: &LevelSpec, column: &mut SchurComplement) -> Option<Clue> {
        let Corrected { motion, scale } = self.solved?;
        // A second more of readout delays a row by as much as a sensor of one second's readout does.
        let slow = Sensor { readout_s: 1.0, ..*spec.sensor };
        column.begin(&self.system);
        for r in self.runs.iter().filter(|r| r.gauge.is_open) {
            let time = self.picture.time(spec, &r.run);
            let row = self.pixels().place[1][((r.run.start + r.run.end) / 2) as usize];
            let share = slow.delay_s(spec.level, row as f64, spec.rays.camera.height());
            let velocity = motion.velocity + motion.acceleration * time.delay_s;
            let turn_rate = motion.turn_rate + motion.turn_acceleration * time.delay_s;
            // Later rows of the tile are delayed the more, by the share of a readout that lies between them.
            let per_second = if spec.sensor.readout_s > 0.0 { 1.0 / spec.sensor.readout_s } else { 0.0 };
            let mut by_readout = TileStep::default();
            for (c, speed) in velocity.iter().chain(&turn_rate).enumerate() {
                by_readout.columns[c] = (speed * share) as f32;
                by_readout.rate[c] = (speed * per_second) as f32;
            }
            let nodes = self.pixels().light().nodes_of(r.run.tile);
            let tile = SolvedTile { equations: &r.equations, step: &r.step, nodes, time, weight: scale.powi(-2) };
            column.add(&self.system, &tile, &by_readout);
        }
        Some(column.finish(&self.system))
    }
}

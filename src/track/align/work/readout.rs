//! What a frame says of the time in which the sensor's rows are read.

use super::super::Sensor;
use super::super::system::side_column::{Clue, SideColumn, SolvedTile};
use super::{Corrected, Task, Work};

impl Work {
    /// The clue on the readout, seconds; `None` where nothing was solved. After [`Work::conclude`].
    pub fn readout_clue(&self, task: &Task, column: &mut SideColumn) -> Option<Clue> {
        let Corrected { motion, scale } = self.solved?;
        // A second more of readout delays a row by as much as a sensor of one second's readout does.
        let slow = Sensor { readout_s: 1.0, ..*task.sensor };
        column.begin(&self.system);
        for r in self.runs.iter().filter(|r| r.gauge.is_open) {
            let time = self.picture.time(task, &r.run);
            let row = self.pixels().place[1][((r.run.start + r.run.end) / 2) as usize];
            let share = slow.delay_s(task.level, row as f64, task.eye.camera.height());
            let shift = (motion.velocity + motion.acceleration * time.delay_s) * share;
            let turn = (motion.turn_rate + motion.turn_acceleration * time.delay_s) * share;
            let nodes = self.pixels().light().nodes_of(r.run.tile);
            let tile = SolvedTile { sums: &r.sums, step: &r.step, nodes, time, weight: scale.powi(-2) };
            column.add(&self.system, &tile, &[shift.x, shift.y, shift.z, turn.x, turn.y, turn.z]);
        }
        Some(column.finish(&self.system))
    }
}

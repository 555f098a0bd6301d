//! What a frame says of the time in which the sensor's rows are read.

use super::super::Sensor;
use super::super::system::System;
use super::super::system::side_column::{Clue, SideColumn, SolvedTile};
use super::{Corrected, Task, Work};

impl Work {
    /// The clue on the readout, seconds. After [`Work::conclude`], with the system that it used.
    pub fn readout_clue(&self, task: &Task, solved: &Corrected, system: &System, column: &mut SideColumn) -> Clue {
        // A second more of readout delays a row by as much as a sensor of one second's readout does.
        let slow = Sensor { readout_s: 1.0, ..*task.sensor };
        let motion = &solved.motion;
        column.begin(system);
        let open = self.pixels.runs.iter().zip(&self.steps).zip(&self.gauges).filter(|(_, g)| g.is_open);
        for (((run, step), _), sums) in open.zip(&self.sums) {
            let time = self.time(task, run);
            let row = self.pixels.place[1][((run.start + run.end) / 2) as usize];
            let share = slow.delay_s(task.level, row as f64, task.eye.camera.height());
            let shift = (motion.velocity + motion.acceleration * time.delay_s) * share;
            let turn = (motion.turn_rate + motion.turn_acceleration * time.delay_s) * share;
            let nodes = self.pixels.grid.nodes_of(run.tile as usize);
            let tile = SolvedTile { sums, step, nodes, time, weight: solved.scale.powi(-2) };
            column.add(system, &tile, &[shift.x, shift.y, shift.z, turn.x, turn.y, turn.z]);
        }
        column.finish(system)
    }
}

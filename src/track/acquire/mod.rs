//! Finding a body from scratch: candidates for its pose, within a work budget.
//!
//! - `view_bank`, `feature_search`: the pictures' features from all sides, matched with the frame's
//! - `candidate`: poses that feature matches support
//! - `expected_candidate`: the same where an earlier pose predicts the body
//! - `unexplained`, `unexplained_cells`, `search_windows`, `expected_view`: the parts of a frame that
//!   no tracked body explains, where missing bodies are searched
//! - `matched_focal`: the focal length that the matches fit
//!
//! Uses `scene`, `frame`, `patches`, `align` and `model_error`.

pub mod candidate;
pub mod expected_candidate;
pub mod expected_view;
pub mod feature_search;
pub mod matched_focal;
pub mod search_windows;
pub mod unexplained;
pub mod unexplained_cells;
pub mod view_bank;

//! Finds a body from scratch: produces candidates for its pose, within a work budget. `body_search`
//! calls these modules and aligns the candidates.
//!
//! - `view_bank`, `feature_search`: features of the reference pictures from all viewing directions,
//!   matched with the frame's
//! - `candidate`: poses that feature matches support
//! - `expected_candidate`: the same, where an earlier pose predicts the body
//! - `unexplained`, `unexplained_cells`, `search_windows`, `expected_view`: the parts of a frame
//!   that no tracked body explains, where missing bodies are searched for
//! - `matched_focal`: the focal length that the matches fit
//!
//! Uses `scene`, `frame`, `patches`, `align` and `model_error`.

pub mod candidate;
pub mod expected_candidate;
pub mod expected_view;
pub mod feature_search;
pub mod matched_focal;
pub mod search_windows;
pub mod tuning;
pub mod unexplained;
pub mod unexplained_cells;
pub mod view_bank;

//! Readers of artifacts, datasets and simulators that more than one stage uses.

pub(crate) mod arm;
pub(crate) mod demos;
pub(crate) mod episodes;
pub(crate) mod estimators;
pub(crate) mod images;
pub(crate) mod simulators;
pub(crate) mod sources;
pub(crate) mod starts;

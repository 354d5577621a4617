//! Measures the library: hard cases for every operator and file format ([`doctor`]), what accuracy costs
//! ([`pareto`]), what effects of a capture cost ([`severity`]), what photos say about a capture ([`capture`]) and
//! what an inference does about it ([`compensation`]).

pub mod capture;
mod charts;
pub mod compensation;
pub mod doctor;
pub mod pareto;
pub mod poses;
pub mod reader;
pub mod recognition;
pub mod severity;
pub mod yardsticks;

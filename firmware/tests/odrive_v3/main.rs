//! The ODrive's board module against recorded register writes and a simulated chip. What is expected is decoded here
//! with the manual's and the board's tables, apart from the firmware's constants.
#![forbid(unsafe_code)]

mod drv8301;
mod flash;
mod gate_driver;
mod lines;
mod pwm;
mod set_up;
mod sim;

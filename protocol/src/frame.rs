use crc::{CRC_32_ISCSI, Crc, Table};
use postcard::ser_flavors::crc::CrcModifier;
use postcard::ser_flavors::{Cobs, Slice};
use serde::{Deserialize, Serialize};

/// The longest frame in bytes, its closing zero included.
pub const FRAME_MAX: usize = 256;

const CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISCSI);

/// What is wrong with a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameError {
    /// Longer than [`FRAME_MAX`].
    TooLong,
    /// Not COBS, a wrong checksum, or not a message of this version.
    Damaged,
}

/// Writes a message as one frame into `buffer` and returns the frame, with its closing zero.
///
/// # Errors
/// [`FrameError::TooLong`] if `buffer` is too short for it.
pub fn encode<'b>(message: &impl Serialize, buffer: &'b mut [u8]) -> Result<&'b [u8], FrameError> {
    // Bytes pass the CRC first, then COBS, then the slice.
    let cobs = Cobs::try_new(Slice::new(buffer)).map_err(|_| FrameError::TooLong)?;
    postcard::serialize_with_flavor(message, CrcModifier::new(cobs, CRC.digest()))
        .map(|frame| &*frame)
        .map_err(|_| FrameError::TooLong)
}

/// Reads one frame, given with or without its closing zero, in place.
///
/// # Errors
/// [`FrameError::Damaged`] for whatever is not a whole and correct frame.
pub fn decode<'b, M: Deserialize<'b>>(frame: &'b mut [u8]) -> Result<M, FrameError> {
    let length = cobs::decode_in_place(frame).map_err(|_| FrameError::Damaged)?;
    let body = frame.get(..length).ok_or(FrameError::Damaged)?;
    postcard::from_bytes_crc32(body, CRC.digest()).map_err(|_| FrameError::Damaged)
}

/// Cuts a stream of bytes into frames. After any garbage the next zero byte begins anew.
#[derive(Debug, Clone)]
pub struct Frames {
    buffer: [u8; FRAME_MAX],
    length: usize,
    too_long: bool,
}

impl Frames {
    /// At the beginning of a frame.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            buffer: [0; FRAME_MAX],
            length: 0,
            too_long: false,
        }
    }

    /// Takes one byte. At the end of a frame returns it, without its zero, for [`decode`]; empty
    /// frames are passed over.
    ///
    /// # Errors
    /// [`FrameError::TooLong`] at the end of a frame that was.
    pub fn push(&mut self, byte: u8) -> Option<Result<&mut [u8], FrameError>> {
        if byte != 0 {
            match self.buffer.get_mut(self.length) {
                Some(place) => {
                    *place = byte;
                    self.length += 1;
                }
                None => self.too_long = true,
            }
            return None;
        }
        let (length, too_long) = (self.length, self.too_long);
        self.length = 0;
        self.too_long = false;
        if too_long {
            return Some(Err(FrameError::TooLong));
        }
        self.buffer
            .get_mut(..length)
            .filter(|frame| !frame.is_empty())
            .map(Ok)
    }
}

impl Default for Frames {
    fn default() -> Self {
        Self::new()
    }
}

//! The few ioctls that the V4L crates do not offer, or offer in a way that may panic.

use std::ffi::CStr;
use std::io;
use std::os::fd::{BorrowedFd, RawFd};
use std::time::Duration;

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use v4l::v4l_sys::{
    V4L2_BUF_FLAG_ERROR, V4L2_BUF_FLAG_TIMESTAMP_MASK, V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC, V4L2_BUF_FLAG_TSTAMP_SRC_MASK,
    V4L2_BUF_FLAG_TSTAMP_SRC_SOE, V4L2_CTRL_FLAG_NEXT_CTRL, v4l2_buffer, v4l2_control, v4l2_query_ext_ctrl, v4l2_querymenu,
};
use v4l::v4l2::vidioc;

use crate::capture::timestamping::DriverStamp;
use crate::frame::Timestamp;

/// Runs third-party code; returns `None` if it panics.
pub(super) fn contained<T>(run: impl FnOnce() -> T) -> Option<T> {
    crate::contain::contained(run).ok()
}

/// Runs an ioctl.
///
/// # Safety
/// `T` must be the struct that the kernel reads and fills for `request`.
unsafe fn ask<T>(fd: RawFd, request: vidioc::_IOC_TYPE, argument: &mut T) -> io::Result<()> {
    // SAFETY: the caller pairs them; the kernel refuses an invalid file descriptor.
    unsafe { v4l::v4l2::ioctl(fd, request, std::ptr::from_mut(argument).cast()) }
}

/// What the driver states about the buffer that was dequeued last: the only one that it does not
/// hold.
pub(super) struct Dequeued {
    pub sequence: u32,
    pub bytes_used: usize,
    pub stamp: DriverStamp,
    pub is_damaged: bool,
}

/// Queries the last dequeued buffer; `None` if the driver does not support the query (v4l2loopback)
/// or more than one buffer is out.
pub(super) fn last_dequeued(fd: RawFd, buffers: u32) -> Option<Dequeued> {
    /// V4L2_BUF_FLAG_QUEUED and V4L2_BUF_FLAG_DONE: the driver holds the buffer, empty or filled.
    const QUEUED_OR_DONE: u32 = 0x2 | 0x4;
    let mut out = None;
    for index in 0..buffers {
        // SAFETY: v4l2_buffer is plain data, for which all zeros are valid.
        let mut buffer: v4l2_buffer = unsafe { std::mem::zeroed() };
        (buffer.index, buffer.type_, buffer.memory) = (index, 1, 1); // video capture, memory map
        // SAFETY: the struct matches the request.
        unsafe { ask(fd, vidioc::VIDIOC_QUERYBUF, &mut buffer) }.ok()?;
        if buffer.flags & QUEUED_OR_DONE == 0 && out.replace(buffer).is_some() {
            return None;
        }
    }
    out.map(|b| {
        let at = Timestamp::from_ns(b.timestamp.tv_sec.saturating_mul(1_000_000_000)).after_ns(b.timestamp.tv_usec.saturating_mul(1_000));
        let monotonic = b.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK == V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
        let at_start = b.flags & V4L2_BUF_FLAG_TSTAMP_SRC_MASK == V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
        let stamp = match (monotonic, at_start) {
            (false, _) => DriverStamp::None,
            (true, true) => DriverStamp::StartOfExposure(at),
            (true, false) => DriverStamp::EndOfFrame(at),
        };
        Dequeued { sequence: b.sequence, bytes_used: b.bytesused as usize, stamp, is_damaged: b.flags & V4L2_BUF_FLAG_ERROR != 0 }
    })
}

/// Whether a picture (or an error to be read) is available within `patience`.
pub(super) fn wait_readable(fd: RawFd, patience: Duration) -> io::Result<bool> {
    // SAFETY: the camera that owns the file descriptor outlives this call.
    let borrowed = unsafe { BorrowedFd::borrow_raw(fd) };
    let limit = PollTimeout::from(patience.as_millis().min(60_000) as u16);
    match poll(&mut [PollFd::new(borrowed, PollFlags::POLLIN)], limit) {
        Ok(ready) => Ok(ready > 0),
        Err(nix::errno::Errno::EINTR) => Ok(false),
        Err(e) => Err(e.into()),
    }
}

/// A control as the driver describes it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ControlDescription {
    pub id: u32,
    pub kind: u32,
    pub name: String,
    pub minimum: i64,
    pub maximum: i64,
    pub step: u64,
    pub default: i64,
    pub flags: u32,
}

/// Lists the simple controls of a device, without compound ones and headings.
pub(super) fn controls(fd: RawFd) -> Vec<ControlDescription> {
    let mut found = Vec::new();
    let mut id = 0;
    // Ids increase with every answer; the bound only keeps a broken driver from looping forever.
    for _ in 0..1024 {
        // SAFETY: plain data, for which all zeros are valid.
        let mut query: v4l2_query_ext_ctrl = unsafe { std::mem::zeroed() };
        query.id = id | V4L2_CTRL_FLAG_NEXT_CTRL;
        // SAFETY: the struct matches the request.
        let answer = unsafe { ask(fd, vidioc::VIDIOC_QUERY_EXT_CTRL, &mut query) };
        if answer.is_err() || query.id <= id {
            break;
        }
        id = query.id;
        let bytes = query.name.map(|c| c as u8);
        let name = CStr::from_bytes_until_nul(&bytes).map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let (minimum, maximum, step) = (query.minimum, query.maximum, query.step);
        found.push(ControlDescription {
            id,
            kind: query.type_,
            name,
            minimum,
            maximum,
            step,
            default: query.default_value,
            flags: query.flags,
        });
    }
    found
}

/// Returns the name of a menu entry, if it exists.
pub(super) fn menu_entry(fd: RawFd, id: u32, index: u32) -> Option<String> {
    // SAFETY: plain data, for which all zeros are valid.
    let mut menu: v4l2_querymenu = unsafe { std::mem::zeroed() };
    (menu.id, menu.index) = (id, index);
    // SAFETY: the struct matches the request.
    unsafe { ask(fd, vidioc::VIDIOC_QUERYMENU, &mut menu) }.ok()?;
    // SAFETY: the union's bytes are valid as bytes whichever variant was written. The struct is
    // packed: copy first.
    let bytes = unsafe { menu.__bindgen_anon_1.name };
    Some(CStr::from_bytes_until_nul(&bytes).ok()?.to_string_lossy().into_owned())
}

/// Returns a control's current value.
pub(super) fn control_value(fd: RawFd, id: u32) -> io::Result<i64> {
    let mut control = v4l2_control { id, value: 0 };
    // SAFETY: the struct matches the request.
    unsafe { ask(fd, vidioc::VIDIOC_G_CTRL, &mut control) }?;
    Ok(control.value.into())
}

/// Sets a control.
pub(super) fn set_control(fd: RawFd, id: u32, value: i64) -> io::Result<()> {
    let value = i32::try_from(value).map_err(|_| io::Error::from(io::ErrorKind::InvalidInput))?;
    // SAFETY: the struct matches the request.
    unsafe { ask(fd, vidioc::VIDIOC_S_CTRL, &mut v4l2_control { id, value }) }
}

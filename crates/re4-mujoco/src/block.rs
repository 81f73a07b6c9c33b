//! One of MuJoCo's structures, in memory of this side.

use std::ffi::c_void;

/// One of MuJoCo's structures, of a size that the version says, aligned as C wants it.
pub(crate) struct Block(Vec<u64>);

impl Block {
    pub(crate) fn new(size: usize) -> Self {
        Self(vec![0; size.div_ceil(8)])
    }

    /// A copy of a structure; what it points to is not copied.
    ///
    /// # Safety
    /// There are so many bytes at the pointer.
    pub(crate) unsafe fn copy(structure: *const c_void, size: usize) -> Self {
        let mut block = Self::new(size);
        // SAFETY: by the caller, and the block is no smaller.
        unsafe { std::ptr::copy_nonoverlapping(structure.cast::<u8>(), block.pointer().cast(), size) };
        block
    }

    pub(crate) fn pointer(&mut self) -> *mut c_void {
        self.0.as_mut_ptr().cast()
    }

    /// # Safety
    /// The structure has `T` at this offset.
    pub(crate) unsafe fn set<T>(&mut self, offset: usize, value: T) {
        debug_assert!(offset + size_of::<T>() <= self.0.len() * 8);
        // SAFETY: by the caller.
        unsafe { self.pointer().byte_add(offset).cast::<T>().write(value) }
    }

    /// # Safety
    /// As for [`Block::set`].
    pub(crate) unsafe fn get<T: Copy>(&mut self, offset: usize) -> T {
        debug_assert!(offset + size_of::<T>() <= self.0.len() * 8);
        // SAFETY: by the caller.
        unsafe { self.pointer().byte_add(offset).cast::<T>().read() }
    }

    /// The bytes of some fields of it.
    pub(crate) fn bytes(&mut self, fields: std::ops::Range<usize>) -> &mut [u8] {
        let size = self.0.len() * 8;
        // SAFETY: these are all bytes of the block, and numbers have no padding.
        let bytes = unsafe { std::slice::from_raw_parts_mut(self.pointer().cast::<u8>(), size) };
        &mut bytes[fields]
    }
}

//! Memory for MuJoCo's C structures.

use std::ffi::c_void;

/// Memory for one of MuJoCo's structures. The size depends on the version. The memory is aligned to 8 bytes.
pub(crate) struct Block(Vec<u64>);

impl Block {
    pub(crate) fn new(size: usize) -> Self {
        Self(vec![0; size.div_ceil(8)])
    }

    /// Copies a structure, but not the data that it points to.
    ///
    /// # Safety
    /// The pointer must be valid for reads of `size` bytes.
    pub(crate) unsafe fn copy(structure: *const c_void, size: usize) -> Self {
        let mut block = Self::new(size);
        // SAFETY: the caller guarantees the source, and the block has at least this size.
        unsafe { std::ptr::copy_nonoverlapping(structure.cast::<u8>(), block.pointer().cast(), size) };
        block
    }

    pub(crate) fn pointer(&mut self) -> *mut c_void {
        self.0.as_mut_ptr().cast()
    }

    /// Writes a field.
    ///
    /// # Safety
    /// The structure must have a field of type `T` at this offset.
    pub(crate) unsafe fn set<T>(&mut self, offset: usize, value: T) {
        debug_assert!(offset + size_of::<T>() <= self.0.len() * 8);
        // SAFETY: the caller guarantees the field.
        unsafe { self.pointer().byte_add(offset).cast::<T>().write(value) }
    }

    /// Reads a field.
    ///
    /// # Safety
    /// The same as for [`Block::set`].
    pub(crate) unsafe fn get<T: Copy>(&mut self, offset: usize) -> T {
        debug_assert!(offset + size_of::<T>() <= self.0.len() * 8);
        // SAFETY: the caller guarantees the field.
        unsafe { self.pointer().byte_add(offset).cast::<T>().read() }
    }

    /// The bytes of the fields in this range of offsets.
    pub(crate) fn bytes(&mut self, fields: std::ops::Range<usize>) -> &mut [u8] {
        let size = self.0.len() * 8;
        // SAFETY: these are exactly the bytes of the block, and `u64` has no padding.
        let bytes = unsafe { std::slice::from_raw_parts_mut(self.pointer().cast::<u8>(), size) };
        &mut bytes[fields]
    }
}

//! As `std::sync::atomic`. At each operation another thread may run; all are sequentially consistent.

use std::sync::atomic as real;

pub use real::Ordering;

use crate::world::scheduler::point;

/// As `std::sync::atomic::fence`.
pub fn fence(order: Ordering) {
    point();
    real::fence(order);
}

macro_rules! atomic {
    ($name:ident($($generic:ident)?), $value:ty) => {
        #[doc = concat!("As `std::sync::atomic::", stringify!($name), "`.")]
        #[repr(transparent)]
        pub struct $name$(<$generic>)?(real::$name$(<$generic>)?);

        impl$(<$generic>)? $name$(<$generic>)? {
            /// An atomic with this value.
            pub const fn new(value: $value) -> Self {
                Self(real::$name::new(value))
            }

            /// Loads the value.
            #[inline]
            pub fn load(&self, order: Ordering) -> $value {
                point();
                self.0.load(order)
            }

            /// Stores a value.
            #[inline]
            pub fn store(&self, value: $value, order: Ordering) {
                point();
                self.0.store(value, order);
            }

            /// Stores a value and returns the previous one.
            #[inline]
            pub fn swap(&self, value: $value, order: Ordering) -> $value {
                point();
                self.0.swap(value, order)
            }

            /// Stores `new` if the value is `current`.
            ///
            /// # Errors
            /// The actual value.
            #[inline]
            pub fn compare_exchange(&self, current: $value, new: $value, success: Ordering, failure: Ordering) -> Result<$value, $value> {
                point();
                self.0.compare_exchange(current, new, success, failure)
            }

            /// As [`Self::compare_exchange`]; never fails spuriously here.
            ///
            /// # Errors
            /// The actual value.
            #[inline]
            pub fn compare_exchange_weak(&self, current: $value, new: $value, success: Ordering, failure: Ordering) -> Result<$value, $value> {
                self.compare_exchange(current, new, success, failure)
            }

            /// The value, through the only reference.
            pub fn get_mut(&mut self) -> &mut $value {
                self.0.get_mut()
            }

            /// The value.
            pub fn into_inner(self) -> $value {
                self.0.into_inner()
            }
        }

        impl$(<$generic>)? std::fmt::Debug for $name$(<$generic>)? {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                self.0.fmt(f)
            }
        }

        impl$(<$generic>)? Default for $name$(<$generic>)? {
            fn default() -> Self {
                Self(Default::default())
            }
        }
    };
}

macro_rules! fetch {
    ($name:ident, $value:ty: $($fetch:ident),*) => {
        impl $name {$(
            /// Changes the value and returns the previous one.
            #[inline]
            pub fn $fetch(&self, value: $value, order: Ordering) -> $value {
                point();
                self.0.$fetch(value, order)
            }
        )*}
    };
}

macro_rules! integer {
    ($($name:ident $value:ty),* $(,)?) => {$(
        atomic!($name(), $value);
        fetch!($name, $value: fetch_add, fetch_sub, fetch_and, fetch_or, fetch_xor, fetch_max, fetch_min);
    )*};
}

integer!(AtomicU8 u8, AtomicU32 u32, AtomicI32 i32, AtomicU64 u64, AtomicI64 i64, AtomicUsize usize);
atomic!(AtomicBool(), bool);
fetch!(AtomicBool, bool: fetch_and, fetch_or, fetch_xor);
atomic!(AtomicPtr(T), *mut T);

//! Writers of images, videos, tables and raw data.

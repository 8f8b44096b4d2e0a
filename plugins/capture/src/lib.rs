//! Sources: cameras, video files, images, pipelines.

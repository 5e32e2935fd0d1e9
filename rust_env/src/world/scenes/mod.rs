//! Where scenes come from: files and generators. One file a format or a generator.

//! Drawing: lines, boxes, text, colour maps.

//! Parts that are soldered to a board.

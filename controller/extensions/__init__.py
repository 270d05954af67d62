"""Parts of a brain beyond the paper; each replaces or wraps a part of the paper's brain."""

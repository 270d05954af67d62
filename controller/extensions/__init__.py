"""Parts of a brain beyond the paper, each of which replaces or wraps a part of the paper's."""

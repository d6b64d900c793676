"""The paper's point maps: functional map, level by level, to vertices and to points (section 5.4)."""

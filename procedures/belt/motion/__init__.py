"""The arm over the belt: which item, along which path, met where and when."""

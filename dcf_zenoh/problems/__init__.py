"""Problems: what there is to solve."""

//! Which points are near: a k-d tree over positions.

use crate::error::CloudError;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use std::num::NonZero;

/// A k-d tree over a cloud's positions.
pub struct Neighbours {
    tree: ImmutableKdTree<f64, 3>,
    count: usize,
}

impl Neighbours {
    /// Returns the tree over positions, mm.
    ///
    /// # Errors
    /// [`CloudError::NonFinite`] for a position that is no finite number, [`CloudError::TooMany`] for more than fit into it.
    pub fn new(positions_mm: &[[f64; 3]]) -> Result<Self, CloudError> {
        let usable = |p: &[f64; 3]| p.iter().all(|c| c.abs() < 1e100);
        if let Some(index) = positions_mm.iter().position(|p| !usable(p)) {
            return Err(CloudError::NonFinite { attribute: "position", index });
        }
        let tree = ImmutableKdTree::new_from_slice(positions_mm);
        let tree = tree.map_err(|_| CloudError::TooMany { got: positions_mm.len() })?;
        Ok(Self { tree, count: positions_mm.len() })
    }

    /// Returns the number of points.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Returns whether there are none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Returns the `count` points nearest to a place, as (squared distance in mm², index), the nearest first.
    pub fn nearest(&self, place_mm: &[f64; 3], count: usize) -> Vec<(f64, usize)> {
        let Some(count) = NonZero::new(count.min(self.count)) else { return Vec::new() };
        let found = self.tree.query(place_mm).nearest_n::<SquaredEuclidean<f64>>(count).execute();
        found.into_iter().map(|near| (near.distance, near.item as usize)).collect()
    }

    /// Returns the point nearest to a place, as (squared distance in mm², index); `None` of no points.
    pub fn nearest_one(&self, place_mm: &[f64; 3]) -> Option<(f64, usize)> {
        if self.count == 0 {
            return None;
        }
        let near = self.tree.query(place_mm).nearest_one::<SquaredEuclidean<f64>>().execute();
        Some((near.distance, near.item as usize))
    }

    /// Returns the points within a distance of a place, as (squared distance in mm², index), in no order to rely on but always the same.
    pub fn within(&self, place_mm: &[f64; 3], reach_mm: f64) -> Vec<(f64, usize)> {
        if self.count == 0 || !reach_mm.is_finite() {
            return Vec::new();
        }
        let query = self.tree.query(place_mm).within::<SquaredEuclidean<f64>>(reach_mm * reach_mm);
        query.unsorted().execute().into_iter().map(|near| (near.distance, near.item as usize)).collect()
    }
}

"""Those who watch every propagation and every correction of the filter: `fusion` calls them."""

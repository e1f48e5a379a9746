"""One module per item; `mbtl.reproduction.runner` lists them."""

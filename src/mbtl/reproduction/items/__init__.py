"""One module per item; `mbtl.reproduction.registry` lists them."""

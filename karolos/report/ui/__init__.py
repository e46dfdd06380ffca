"""`karolos ui`: a local web page over the runs folder and its database. Uses starlette and uvicorn."""

"""Image files: textures in, EXR and PNG out. The only importer of OpenImageIO and OpenColorIO."""

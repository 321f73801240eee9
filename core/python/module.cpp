// The Python module: one per instruction set, the package chooses at load.
#include <nanobind/stl/string.h>

#include "python/bindings.h"

#include "accel/accel.h"

NB_MODULE(FOOTLIGHT_MODULE, module) {
    module.doc() = "Footlight's core: scenes in, converging images out.";
    module.attr("__version__") = FOOTLIGHT_VERSION;
    module.attr("instruction_set") = FOOTLIGHT_INSTRUCTION_SET;
    module.attr("embree_version") = footlight::Accel::embree_version();
    footlight::bind_scene(module);
    footlight::bind_renderer(module);
    footlight::bind_subdiv(module);
}

// The parts of the Python module.
#pragma once

#include <nanobind/nanobind.h>

namespace footlight {

void bind_scene(nanobind::module_& module);
void bind_renderer(nanobind::module_& module);
void bind_subdiv(nanobind::module_& module);

}  // namespace footlight

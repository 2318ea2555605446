#pragma once
#include <stdint.h>
#define M2T(milliseconds) ((uint32_t)(milliseconds))

/* Declarations of Arduino that the project uses, written from its published interface. */
#pragma once
#include <stdbool.h>
#include <stdint.h>

uint32_t micros();
struct StubSerial {
    void begin(unsigned long) {}
    void println(unsigned long) {}
};
extern StubSerial Serial;
void setup();
void loop();

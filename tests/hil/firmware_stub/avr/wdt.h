#pragma once
enum { WDTO_500MS = 5 };
void wdt_enable(int timeout);
void wdt_reset();
